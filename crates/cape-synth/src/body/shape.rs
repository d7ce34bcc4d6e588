//! Ten shape directions of the synthetic body.

use glam::DVec3;

use super::{
    figure::{MIRRORED, parent},
    rig::Weights,
    surface::{SymmetricMesh, normals},
};
use cape_core::joints::JOINTS;

/// Number of shape directions.
pub(super) const DIRECTIONS: usize = 10;

/// Gaussian displacement along the surface normal on both sides of the body: centre and spread,
/// metres, height at one standard deviation, millimetres.
type Bulge = ([f64; 3], [f64; 3], f64);

/// Change of the body per standard deviation of one direction: relative growth of the part of each
/// joint along x, y and z (`(joint, growth)`; left joints stand for both sides), and local bulges.
struct ShapeDirection {
    growth: &'static [(usize, [f64; 3])],
    bulges: &'static [Bulge],
}

/// Stature; weight; limb length; leg length relative to the trunk; shoulder width; hip width; belly;
/// chest; muscle; head size.
const SHAPES: [ShapeDirection; DIRECTIONS] = [
    ShapeDirection {
        growth: &[
            (0, [0.024, 0.036, 0.022]),
            (3, [0.022, 0.036, 0.022]),
            (6, [0.022, 0.036, 0.022]),
            (9, [0.026, 0.036, 0.022]),
            (12, [0.016, 0.034, 0.016]),
            (15, [0.014, 0.016, 0.014]),
            (13, [0.030, 0.030, 0.022]),
            (16, [0.042, 0.018, 0.018]),
            (18, [0.044, 0.016, 0.016]),
            (20, [0.032, 0.020, 0.026]),
            (22, [0.032, 0.020, 0.026]),
            (1, [0.016, 0.046, 0.016]),
            (4, [0.018, 0.048, 0.018]),
            (7, [0.022, 0.022, 0.034]),
            (10, [0.022, 0.022, 0.034]),
        ],
        bulges: &[],
    },
    ShapeDirection {
        growth: &[
            (0, [0.055, 0.0, 0.070]),
            (3, [0.085, 0.0, 0.110]),
            (6, [0.080, 0.0, 0.105]),
            (9, [0.045, 0.0, 0.070]),
            (12, [0.055, 0.0, 0.060]),
            (15, [0.020, 0.004, 0.012]),
            (13, [0.010, 0.050, 0.060]),
            (16, [0.0, 0.105, 0.105]),
            (18, [0.0, 0.070, 0.070]),
            (20, [0.0, 0.030, 0.025]),
            (22, [0.0, 0.030, 0.020]),
            (1, [0.095, 0.0, 0.090]),
            (4, [0.065, 0.0, 0.065]),
            (7, [0.025, 0.0, 0.010]),
        ],
        bulges: &[
            ([0.045, -0.120, 0.090], [0.070, 0.075, 0.060], 7.0),
            ([0.125, -0.150, 0.000], [0.040, 0.070, 0.080], 5.0),
            ([0.075, -0.310, -0.110], [0.060, 0.070, 0.050], 5.0),
            ([0.070, 0.100, 0.100], [0.050, 0.045, 0.050], 4.0),
            ([0.050, 0.375, 0.070], [0.025, 0.025, 0.040], 2.0),
            ([0.000, 0.325, 0.070], [0.030, 0.015, 0.030], 3.0),
        ],
    },
    ShapeDirection {
        growth: &[
            (16, [0.060, 0.0, 0.0]),
            (18, [0.065, 0.0, 0.0]),
            (20, [0.040, 0.0, 0.0]),
            (22, [0.040, 0.0, 0.0]),
            (1, [0.0, 0.042, 0.0]),
            (4, [0.0, 0.048, 0.0]),
            (7, [0.0, 0.0, 0.024]),
            (10, [0.0, 0.0, 0.024]),
        ],
        bulges: &[],
    },
    ShapeDirection {
        growth: &[
            (0, [0.0, -0.035, 0.0]),
            (3, [0.0, -0.048, 0.0]),
            (6, [0.0, -0.048, 0.0]),
            (9, [0.0, -0.035, 0.0]),
            (12, [0.0, -0.020, 0.0]),
            (1, [0.0, 0.032, 0.0]),
            (4, [0.0, 0.032, 0.0]),
        ],
        bulges: &[],
    },
    ShapeDirection {
        growth: &[
            (9, [0.030, 0.0, 0.010]),
            (13, [0.105, 0.020, 0.020]),
            (16, [0.0, 0.020, 0.020]),
            (6, [0.012, 0.0, 0.0]),
        ],
        bulges: &[([0.120, 0.090, -0.040], [0.040, 0.070, 0.070], 3.0)],
    },
    ShapeDirection {
        growth: &[(0, [0.062, 0.0, 0.020]), (1, [0.030, 0.0, 0.015]), (3, [0.016, 0.0, 0.0])],
        bulges: &[
            ([0.165, -0.330, 0.000], [0.035, 0.070, 0.070], 5.0),
            ([0.080, -0.320, -0.115], [0.055, 0.065, 0.050], 4.0),
        ],
    },
    ShapeDirection {
        growth: &[(3, [0.012, 0.0, 0.020]), (6, [0.006, 0.0, 0.015])],
        bulges: &[
            ([0.030, -0.110, 0.105], [0.060, 0.075, 0.060], 9.0),
            ([0.030, -0.030, 0.100], [0.060, 0.060, 0.060], 4.0),
            ([0.120, -0.110, 0.020], [0.040, 0.050, 0.060], 4.0),
        ],
    },
    ShapeDirection {
        growth: &[(9, [0.016, 0.0, 0.030]), (6, [0.008, 0.0, 0.012])],
        bulges: &[
            ([0.075, 0.100, 0.100], [0.042, 0.042, 0.050], 9.0),
            ([0.080, 0.130, -0.110], [0.060, 0.070, 0.040], 2.0),
        ],
    },
    ShapeDirection {
        growth: &[
            (3, [-0.010, 0.0, -0.010]),
            (12, [0.030, 0.0, 0.030]),
            (16, [0.0, 0.030, 0.030]),
            (18, [0.0, 0.030, 0.025]),
            (1, [0.018, 0.0, 0.018]),
            (4, [0.022, 0.0, 0.022]),
        ],
        bulges: &[
            ([0.190, 0.240, -0.025], [0.050, 0.030, 0.060], 6.0),
            ([0.310, 0.225, 0.015], [0.050, 0.030, 0.025], 5.0),
            ([0.300, 0.212, -0.080], [0.055, 0.030, 0.025], 5.0),
            ([0.485, 0.210, -0.005], [0.045, 0.030, 0.025], 3.0),
            ([0.075, 0.125, 0.100], [0.050, 0.040, 0.050], 6.0),
            ([0.130, 0.090, -0.070], [0.035, 0.070, 0.060], 6.0),
            ([0.075, 0.275, -0.045], [0.050, 0.030, 0.040], 6.0),
            ([0.115, -0.500, 0.070], [0.050, 0.100, 0.040], 5.0),
            ([0.080, -0.830, -0.070], [0.030, 0.060, 0.040], 4.0),
            ([0.135, -0.820, -0.055], [0.025, 0.060, 0.040], 3.0),
        ],
    },
    ShapeDirection {
        growth: &[(15, [0.034, 0.034, 0.034]), (12, [0.015, 0.010, 0.015])],
        bulges: &[],
    },
];

/// Shape directions, metres per standard deviation, `[10][6890]`: symmetric in x = 0 and orthogonalised
/// in order.
pub(super) fn shape_directions(
    skin: &SymmetricMesh,
    weights: &[Weights],
    joints: &[DVec3; JOINTS],
) -> Vec<Vec<DVec3>> {
    let normals = normals(&skin.vertices, &skin.faces);
    let mut directions: Vec<Vec<DVec3>> = Vec::with_capacity(DIRECTIONS);
    for shape in &SHAPES {
        let mut direction = displacement(shape, skin, &normals, weights, joints);
        for earlier in &directions {
            let overlap = dot(&direction, earlier) / dot(earlier, earlier);
            direction.iter_mut().zip(earlier).for_each(|(d, e)| *d -= *e * overlap);
        }
        directions.push(direction);
    }
    directions
}

fn dot(a: &[DVec3], b: &[DVec3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum()
}

fn displacement(
    shape: &ShapeDirection,
    skin: &SymmetricMesh,
    normals: &[DVec3],
    weights: &[Weights],
    joints: &[DVec3; JOINTS],
) -> Vec<DVec3> {
    let mut growth = [DVec3::ZERO; JOINTS];
    for &(joint, along) in shape.growth {
        growth[joint] = DVec3::from_array(along);
        growth[MIRRORED[joint]] = growth[joint];
    }
    // A joint moves by the growth of the parts between it and the pelvis.
    let mut moved = [DVec3::ZERO; JOINTS];
    for joint in 1..JOINTS {
        let above = parent(joint);
        moved[joint] = moved[above] + growth[above] * (joints[joint] - joints[above]);
    }
    (0..skin.vertices.len())
        .map(|v| {
            let m = skin.mirror[v] as usize;
            if skin.vertices[v].x < 0.0 { (m, -1.0) } else { (v, 1.0) }
        })
        .map(|(v, side)| {
            let p = skin.vertices[v];
            let grown: DVec3 =
                (0..JOINTS).map(|j| (moved[j] + growth[j] * (p - joints[j])) * weights[v][j]).sum();
            let d = grown + normals[v] * bulge_height(shape.bulges, p);
            let x = if skin.vertices[v].x == 0.0 { 0.0 } else { d.x };
            DVec3::new(side * x, d.y, d.z)
        })
        .collect()
}

/// Sum of the bulges at `p`, metres.
fn bulge_height(bulges: &[Bulge], p: DVec3) -> f64 {
    let mirrored = DVec3::new(-p.x, p.y, p.z);
    bulges
        .iter()
        .map(|&(centre, spread, height)| {
            let bell = |p: DVec3| {
                let q = (p - DVec3::from_array(centre)) / DVec3::from_array(spread);
                (-0.5 * q.length_squared()).exp() * height / 1000.0
            };
            // A bulge on the mid-line counts once.
            if centre[0] == 0.0 { bell(p) } else { bell(p) + bell(mirrored) }
        })
        .sum()
}
