use std::collections::HashMap;

use glam::{DMat3, DVec2, DVec3};
use rayon::prelude::*;

use super::material::{ClothMaterial, StretchStiffness};
use cape_core::geometry::SurfaceMesh;

/// Least number of elements that a thread takes.
pub(super) const GRAIN: usize = 512;

/// A triangle of constant strain with the energy of Saint Venant and Kirchhoff.
#[derive(Debug, Clone)]
struct Membrane {
    corners: [u32; 3],
    /// Gradients of the barycentric coordinates along weft and warp, 1/m.
    slopes: [DVec2; 3],
    area: f64,
    stiffness: StretchStiffness,
}

/// Two neighbouring triangles: ends of their edge, then their opposite corners.
#[derive(Debug, Clone)]
struct Hinge {
    corners: [u32; 4],
    /// Dihedral angle at rest, radians.
    rest: f64,
    /// Energy is half of it times the squared change of the angle, N·m.
    stiffness: f64,
}

/// Linearisation of a membrane at one state.
#[derive(Debug, Clone, Copy, Default)]
struct MembraneState {
    /// Images of the unit vectors along weft and warp.
    weft: DVec3,
    warp: DVec3,
    /// Stress along weft, warp and in shear, N/m, and its positive semidefinite part.
    stress: [f64; 3],
    tension: [f64; 3],
}

/// Linearisation of a hinge at one state.
#[derive(Debug, Clone, Copy, Default)]
struct HingeState {
    /// Gradient of the angle for each corner, 1/m.
    gradients: [DVec3; 4],
    /// Derivative of the energy by the angle, N·m.
    moment: f64,
}

/// Elastic forces of a cloth: stretch and shear of its triangles, and bending of its inner edges.
#[derive(Debug, Clone)]
pub(super) struct ElasticForces {
    membranes: Vec<Membrane>,
    hinges: Vec<Hinge>,
    membrane_states: Vec<MembraneState>,
    hinge_states: Vec<HingeState>,
    /// Uses of each vertex: element and corner.
    in_membranes: Vec<Vec<(u32, u8)>>,
    in_hinges: Vec<Vec<(u32, u8)>>,
}

impl ElasticForces {
    pub(super) fn new(rest: &SurfaceMesh, material: &ClothMaterial) -> Self {
        let membranes: Vec<Membrane> = (0..rest.faces.len())
            .filter_map(|face| {
                let [a, b, c] = rest.corners(face);
                let cross = (b - a).cross(c - a);
                let normal = cross.try_normalize()?;
                // The warp is vertical, or along z where the cloth is level.
                let along = |axis: DVec3| axis - normal * axis.dot(normal);
                let up = along(DVec3::Y);
                let warp = if up.length() > 0.1 { up } else { along(DVec3::Z) }.normalize();
                let weft = warp.cross(normal);
                let slope = |from: DVec3, to: DVec3| {
                    let across = normal.cross(to - from) / cross.length();
                    DVec2::new(across.dot(weft), across.dot(warp))
                };
                Some(Membrane {
                    corners: rest.faces[face],
                    slopes: [slope(b, c), slope(c, a), slope(a, b)],
                    area: 0.5 * cross.length(),
                    stiffness: material.stretch,
                })
            })
            .collect();
        let hinges: Vec<Hinge> = hinges(&rest.faces)
            .into_iter()
            .map(|corners| {
                let [a, b, c, d] = corners.map(|v| rest.vertices[v as usize]);
                let edge = b - a;
                let areas = 0.5 * (edge.cross(c - a).length() + edge.cross(d - a).length());
                let stiffness =
                    material.bend * edge.length_squared() / areas.max(f64::MIN_POSITIVE);
                Hinge {
                    corners,
                    rest: dihedral([a, b, c, d]).map_or(0.0, |(angle, _)| angle),
                    stiffness,
                }
            })
            .collect();
        let mut in_membranes = vec![Vec::new(); rest.vertices.len()];
        for (element, membrane) in membranes.iter().enumerate() {
            for (corner, &v) in membrane.corners.iter().enumerate() {
                in_membranes[v as usize].push((element as u32, corner as u8));
            }
        }
        let mut in_hinges = vec![Vec::new(); rest.vertices.len()];
        for (element, hinge) in hinges.iter().enumerate() {
            for (corner, &v) in hinge.corners.iter().enumerate() {
                in_hinges[v as usize].push((element as u32, corner as u8));
            }
        }
        Self {
            membrane_states: vec![MembraneState::default(); membranes.len()],
            hinge_states: vec![HingeState::default(); hinges.len()],
            membranes,
            hinges,
            in_membranes,
            in_hinges,
        }
    }

    /// Vertices that share an element with each vertex, ascending, itself included.
    pub(super) fn stencils(&self) -> Vec<Vec<u32>> {
        let stencil = |v: usize| {
            let membranes =
                self.in_membranes[v].iter().flat_map(|&(m, _)| self.membranes[m as usize].corners);
            let hinges =
                self.in_hinges[v].iter().flat_map(|&(h, _)| self.hinges[h as usize].corners);
            let mut all: Vec<u32> = membranes.chain(hinges).chain([v as u32]).collect();
            all.sort_unstable();
            all.dedup();
            all
        };
        (0..self.in_membranes.len()).map(stencil).collect()
    }

    /// Computes strains and angles at the positions `at`, metres.
    pub(super) fn linearise(&mut self, at: &[DVec3]) {
        self.membranes
            .par_iter()
            .zip(&mut self.membrane_states)
            .with_min_len(GRAIN)
            .for_each(|(membrane, state)| *state = membrane.state(at));
        self.hinges
            .par_iter()
            .zip(&mut self.hinge_states)
            .with_min_len(GRAIN)
            .for_each(|(hinge, state)| *state = hinge.state(at));
    }

    /// Force on a vertex in the linearised state, newtons.
    pub(super) fn force(&self, vertex: usize) -> DVec3 {
        let mut force = DVec3::ZERO;
        for &(element, corner) in &self.in_membranes[vertex] {
            let membrane = &self.membranes[element as usize];
            let MembraneState { weft, warp, stress, .. } = self.membrane_states[element as usize];
            let slope = membrane.slopes[corner as usize];
            force -= (weft * (slope.x * stress[0] + slope.y * stress[2])
                + warp * (slope.y * stress[1] + slope.x * stress[2]))
                * membrane.area;
        }
        for &(element, corner) in &self.in_hinges[vertex] {
            let HingeState { gradients, moment } = &self.hinge_states[element as usize];
            force -= gradients[corner as usize] * *moment;
        }
        force
    }

    /// Adds the derivatives of the negative force on a vertex to `row`, one block for each vertex of
    /// its `stencil`, N/m. The negative curvature of compressed cloth is left out.
    pub(super) fn add_stiffness(&self, vertex: usize, stencil: &[u32], row: &mut [DMat3]) {
        let place = |v: u32| stencil.binary_search(&v).unwrap_or(0);
        for &(element, corner) in &self.in_membranes[vertex] {
            let membrane = &self.membranes[element as usize];
            let state = &self.membrane_states[element as usize];
            for (other, &v) in membrane.corners.iter().enumerate() {
                row[place(v)] += membrane.block(state, corner as usize, other);
            }
        }
        for &(element, corner) in &self.in_hinges[vertex] {
            let hinge = &self.hinges[element as usize];
            let gradients = &self.hinge_states[element as usize].gradients;
            let own = gradients[corner as usize] * hinge.stiffness;
            for (&v, &other) in hinge.corners.iter().zip(gradients) {
                row[place(v)] += outer(own, other);
            }
        }
    }

    /// Elastic energy at the positions `at`, joules.
    pub(super) fn energy(&self, at: &[DVec3]) -> f64 {
        let stretch = self.membranes.iter().map(|membrane| {
            let state = membrane.state(at);
            let strain = strain(state.weft, state.warp);
            0.5 * membrane.area * strain.iter().zip(state.stress).map(|(e, s)| e * s).sum::<f64>()
        });
        let bend = self.hinges.iter().map(|hinge| {
            let HingeState { moment, .. } = hinge.state(at);
            0.5 * moment * moment / hinge.stiffness.max(f64::MIN_POSITIVE)
        });
        stretch.sum::<f64>() + bend.sum::<f64>()
    }
}

/// Green strain along weft and warp, and twice the one in shear.
fn strain(weft: DVec3, warp: DVec3) -> [f64; 3] {
    [0.5 * (weft.length_squared() - 1.0), 0.5 * (warp.length_squared() - 1.0), weft.dot(warp)]
}

/// The matrix `a bᵀ`.
pub(super) fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}

impl Membrane {
    fn state(&self, at: &[DVec3]) -> MembraneState {
        let (mut weft, mut warp) = (DVec3::ZERO, DVec3::ZERO);
        for (&v, slope) in self.corners.iter().zip(self.slopes) {
            weft += at[v as usize] * slope.x;
            warp += at[v as usize] * slope.y;
        }
        let [e0, e1, e2] = strain(weft, warp);
        let c = &self.stiffness;
        let stress = [c.weft * e0 + c.coupling * e1, c.coupling * e0 + c.warp * e1, c.shear * e2];
        MembraneState { weft, warp, stress, tension: positive_part(stress) }
    }

    /// Derivative of the negative force on corner `i` by the position of corner `j`.
    fn block(&self, state: &MembraneState, i: usize, j: usize) -> DMat3 {
        let (p, q, c) = (self.slopes[i], self.slopes[j], &self.stiffness);
        let MembraneState { weft, warp, tension: [t0, t1, t2], .. } = *state;
        let geometric = p.x * q.x * t0 + p.y * q.y * t1 + (p.x * q.y + p.y * q.x) * t2;
        let (shear_p, shear_q) = (warp * p.x + weft * p.y, warp * q.x + weft * q.y);
        let along_weft = weft * (c.weft * q.x) * p.x + warp * (c.coupling * q.y) * p.x;
        let along_warp = weft * (c.coupling * q.x) * p.y + warp * (c.warp * q.y) * p.y;
        let material =
            outer(weft, along_weft) + outer(warp, along_warp) + outer(shear_p, shear_q * c.shear);
        (DMat3::from_diagonal(DVec3::splat(geometric)) + material) * self.area
    }
}

/// Positive semidefinite part of a symmetric matrix `[xx, yy, xy]`.
fn positive_part([xx, yy, xy]: [f64; 3]) -> [f64; 3] {
    let (mean, half) = (0.5 * (xx + yy), 0.5 * (xx - yy));
    let radius = half.hypot(xy);
    let (high, low) = (mean + radius, mean - radius);
    if low >= 0.0 {
        [xx, yy, xy]
    } else if high <= 0.0 {
        [0.0; 3]
    } else {
        // The larger eigenvalue times the projection onto its eigenvector.
        let scale = 0.5 * high / radius;
        [scale * (radius + half), scale * (radius - half), scale * xy]
    }
}

impl Hinge {
    fn state(&self, at: &[DVec3]) -> HingeState {
        let corners = self.corners.map(|v| at[v as usize]);
        let Some((angle, gradients)) = dihedral(corners) else { return HingeState::default() };
        let turn = std::f64::consts::TAU;
        let change = (angle - self.rest + 0.5 * turn).rem_euclid(turn) - 0.5 * turn;
        HingeState { gradients, moment: self.stiffness * change }
    }
}

/// Angle between the normals of the triangles `abc` and `bad`, radians, and its gradient for each
/// corner; nothing for triangles that are almost segments.
pub(super) fn dihedral([a, b, c, d]: [DVec3; 4]) -> Option<(f64, [DVec3; 4])> {
    const FLAT: f64 = 0.05;
    let edge = b - a;
    let length = edge.length();
    let (left, right) = (edge.cross(c - a), (d - a).cross(edge));
    let least = FLAT * length * length;
    if left.length() < least || right.length() < least || length == 0.0 {
        return None;
    }
    let angle = (left.cross(right).dot(edge) / length).atan2(left.dot(right));
    let over_c = left * (-length / left.length_squared());
    let over_d = right * (-length / right.length_squared());
    let share = |p: DVec3| (p - a).dot(edge) / (length * length);
    let (at_c, at_d) = (share(c), share(d));
    let over_a = -over_c * (1.0 - at_c) - over_d * (1.0 - at_d);
    let over_b = -over_c * at_c - over_d * at_d;
    Some((angle, [over_a, over_b, over_c, over_d]))
}

/// Ends of each inner edge and the opposite corners of its faces.
fn hinges(faces: &[[u32; 3]]) -> Vec<[u32; 4]> {
    let mut seen: HashMap<[u32; 2], (u32, u32)> = HashMap::new();
    let mut all = Vec::new();
    for face in faces {
        for i in 0..3 {
            let (p, q, far) = (face[i], face[(i + 1) % 3], face[(i + 2) % 3]);
            if let Some((start, other)) = seen.insert([p.min(q), p.max(q)], (p, far)) {
                let end = if start == p { q } else { p };
                all.push([start, end, other, far]);
            }
        }
    }
    all
}
