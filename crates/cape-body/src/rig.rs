//! SMPL's joints and blend weights from MakeHuman's.

use glam::DVec3;

use crate::{
    Error, Result,
    assets::{BaseMesh, BoneWeights, SKIN},
};
use cape_core::joints::{JOINTS, PARENTS};

/// Blend weights of a vertex.
pub(crate) type Weights = [f64; JOINTS];

/// Joint on the other side.
pub(crate) const MIRRORED: [usize; JOINTS] =
    [0, 2, 1, 3, 5, 4, 6, 8, 7, 9, 11, 10, 12, 14, 13, 15, 17, 16, 19, 18, 21, 20, 23, 22];

/// SMPL's joints as weighted means of MakeHuman's joint markers; left joints stand for both sides.
const MARKERS: [(usize, &[(&str, f64)]); 15] = [
    (0, &[("pelvis", 0.5), ("spine-4", 0.5)]),
    (1, &[("l-upper-leg", 1.0)]),
    (3, &[("spine-3", 1.0)]),
    (4, &[("l-knee", 1.0)]),
    (6, &[("spine-2", 1.0)]),
    (7, &[("l-ankle", 1.0)]),
    (9, &[("spine-2", 0.3), ("spine-1", 0.7)]),
    (10, &[("l-toe-1-1", 0.4), ("l-toe-3-1", 0.6)]),
    (12, &[("neck", 1.0)]),
    (13, &[("l-clavicle", 0.55), ("l-shoulder", 0.45)]),
    (15, &[("head", 1.0)]),
    (16, &[("l-shoulder", 1.0)]),
    (18, &[("l-elbow", 1.0)]),
    (20, &[("l-hand", 1.0)]),
    (
        22,
        &[
            ("l-finger-2-1", 0.25),
            ("l-finger-3-1", 0.25),
            ("l-finger-4-1", 0.25),
            ("l-finger-5-1", 0.25),
        ],
    ),
];

/// Vertices whose weighted sum is a joint.
pub(crate) struct JointMarkers(Vec<Vec<(u32, f64)>>);

impl JointMarkers {
    pub(crate) fn new(base: &BaseMesh) -> Result<Self> {
        let mut markers = vec![Vec::new(); JOINTS];
        for (joint, means) in MARKERS {
            for &(name, weight) in means {
                let group = base.groups.get(&format!("joint-{name}")).ok_or_else(|| {
                    Error::argument(format!("base mesh: expected a group `joint-{name}`"))
                })?;
                let each = weight / group.len() as f64;
                markers[joint].extend(group.iter().map(|&v| (v, each)));
            }
        }
        for joint in 0..JOINTS {
            if MIRRORED[joint] < joint {
                let image = |&(v, weight): &(u32, f64)| (base.mirror[v as usize], weight);
                markers[joint] = markers[MIRRORED[joint]].iter().map(image).collect();
            }
        }
        Ok(Self(markers))
    }

    /// Positions of the joints, mirror-symmetric.
    pub(crate) fn joints(&self, vertices: &[DVec3]) -> [DVec3; JOINTS] {
        let mean = |joint: usize| -> DVec3 {
            self.0[joint].iter().map(|&(v, weight)| vertices[v as usize] * weight).sum()
        };
        std::array::from_fn(|joint| {
            let other = mean(MIRRORED[joint]);
            mean(joint).midpoint(DVec3::new(-other.x, other.y, other.z))
        })
    }
}

/// SMPL's joint that moves MakeHuman's bone.
fn joint_of(bone: &str) -> usize {
    let (name, side) = bone.split_once('.').unwrap_or((bone, ""));
    let left = match name.trim_end_matches(|c: char| c.is_ascii_digit() || c == '-') {
        "root" | "pelvis" => 0,
        "spine" => match name {
            "spine03" => 3,
            "spine02" => 6,
            "spine01" => 9,
            _ => 0,
        },
        "breast" => 9,
        "neck" => 12,
        "clavicle" | "shoulder" => 13,
        "upperarm" => 16,
        "lowerarm" => 18,
        "wrist" | "metacarpal" => 20,
        "finger" => 22,
        "upperleg" => 1,
        "lowerleg" => 4,
        "foot" => 7,
        "toe" => 10,
        _ => 15,
    };
    if side == "R" { MIRRORED[left] } else { left }
}

/// Blend weights of the body's vertices, smoothed and mirror-symmetric; rows sum to 1.
pub(crate) fn blend_weights(
    base: &BaseMesh,
    bones: &[BoneWeights],
    around: &[Vec<u32>],
) -> Vec<Weights> {
    let mut rows = vec![[0.0; JOINTS]; SKIN];
    for (bone, list) in bones {
        let joint = joint_of(bone);
        for &(v, weight) in list {
            if let Some(row) = rows.get_mut(v as usize) {
                row[joint] += weight.max(0.0);
            }
        }
    }
    for row in &mut rows {
        let sum: f64 = row.iter().sum();
        if sum > 0.0 {
            for weight in row {
                *weight /= sum;
            }
        } else {
            row[15] = 1.0;
        }
    }
    for _ in 0..4 {
        rows = around
            .iter()
            .zip(&rows)
            .map(|(near, own)| {
                std::array::from_fn(|j| {
                    let mean: f64 = near.iter().map(|&n| rows[n as usize][j]).sum();
                    0.5 * own[j] + 0.5 * mean / near.len().max(1) as f64
                })
            })
            .collect();
    }
    (0..SKIN)
        .map(|v| {
            let image = &rows[base.mirror[v] as usize];
            std::array::from_fn(|j| f64::midpoint(rows[v][j], image[MIRRORED[j]]))
        })
        .collect()
}

/// Keeps the four largest weights less the fifth, so that the result is continuous.
pub(crate) fn four_largest(row: Weights) -> Weights {
    let mut sorted = row;
    sorted.sort_by(|a, b| b.total_cmp(a));
    let cut = sorted[4].max(1e-3);
    let kept = row.map(|weight| (weight - cut).max(0.0));
    let sum: f64 = kept.iter().sum();
    kept.map(|weight| weight / sum)
}

/// True if `joint` is `ancestor` or follows it.
pub(crate) fn follows(joint: usize, ancestor: usize) -> bool {
    let mut at = Some(joint);
    while let Some(now) = at {
        if now == ancestor {
            return true;
        }
        at = PARENTS[now];
    }
    false
}
