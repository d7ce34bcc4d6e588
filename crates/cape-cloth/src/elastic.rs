use std::collections::HashMap;

use glam::{DMat3, DVec2, DVec3, Mat3, Vec3};
use rayon::prelude::*;

use super::{
    material::{ClothMaterial, StretchStiffness},
    reinforce::ElasticBand,
};
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
    /// Damping relative to the stiffness, seconds.
    damping: f64,
}

/// Two neighbouring triangles: ends of their edge, then their opposite corners.
#[derive(Debug, Clone)]
struct Hinge {
    corners: [u32; 4],
    /// Dihedral angle at rest, radians.
    rest: f64,
    /// Energy is half of it times the squared change of the angle, N·m.
    stiffness: f64,
    /// Damping relative to the stiffness, seconds.
    damping: f64,
}

/// Linearisation of a membrane at one state.
#[derive(Debug, Clone, Copy, Default)]
struct MembraneState {
    /// Images of the unit vectors along weft and warp.
    weft: Vec3,
    warp: Vec3,
    /// Positive semidefinite part of the stress along weft, warp and in shear, N/m.
    tension: [f32; 3],
    /// Area times `dt (dt + damping)`, m²·s².
    weight: f32,
    /// Negative impulses for slopes along weft and warp, N·m·s.
    pulls: [DVec3; 2],
}

/// Linearisation of a hinge at one state.
#[derive(Debug, Clone, Copy, Default)]
struct HingeState {
    /// Gradient of the angle for each corner, 1/m.
    gradients: [Vec3; 4],
    /// Negative impulse for a gradient of 1, N·m·s.
    moment: f64,
    /// Stiffness times `dt (dt + damping)`, N·m·s².
    weight: f32,
}

/// An element's part in a block of the matrix: the derivative of the negative force on one of its
/// corners by the position of another.
#[derive(Debug, Clone, Copy)]
pub(super) struct Contribution {
    element: u32,
    corner: u8,
    other: u8,
    is_hinge: bool,
    /// Block of the row.
    slot: u16,
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
    /// Forces of a cloth with the rest surface `rest`; `material` is of a vertex.
    pub(super) fn new<'a>(rest: &SurfaceMesh, material: impl Fn(u32) -> &'a ClothMaterial) -> Self {
        let membranes: Vec<Membrane> = (0..rest.faces.len())
            .filter_map(|face| {
                // The warp is vertical, or along z where the cloth is level.
                let warp = |normal: DVec3| {
                    let along = |axis: DVec3| axis - normal * axis.dot(normal);
                    let up = along(DVec3::Y);
                    if up.length() > 0.1 { up } else { along(DVec3::Z) }.normalize()
                };
                let of = material(rest.faces[face][0]);
                Membrane::new(rest, face, (of.stretch, of.damping), warp)
            })
            .collect();
        let hinges: Vec<Hinge> = hinges(&rest.faces)
            .into_iter()
            .map(|corners| {
                let [a, b, c, d] = corners.map(|v| rest.vertices[v as usize]);
                let edge = b - a;
                let areas = 0.5 * (edge.cross(c - a).length() + edge.cross(d - a).length());
                let of = material(corners[0]);
                let stiffness = of.bend * edge.length_squared() / areas.max(f64::MIN_POSITIVE);
                Hinge {
                    corners,
                    rest: dihedral([a, b, c, d]).map_or(0.0, |(angle, _)| angle),
                    stiffness,
                    damping: of.damping,
                }
            })
            .collect();
        let mut in_membranes = vec![Vec::new(); rest.vertices.len()];
        for (element, membrane) in membranes.iter().enumerate() {
            membrane.enter(element, &mut in_membranes);
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

    /// Makes the cloth bend as two layers that do not slide on each other where the `shares` of vertices
    /// are 1.
    pub(super) fn double(&mut self, shares: &[f64]) {
        for hinge in &mut self.hinges {
            // The ends of the edge that bends.
            let [a, b, ..] = hinge.corners.map(|v| shares[v as usize]);
            hinge.stiffness *= 1.0 + (BONDED - 1.0) * a.midpoint(b);
        }
    }

    /// Adds the forces of an elastic to those of a cloth with the rest surface `rest`; `material` is of a
    /// vertex.
    pub(super) fn gather<'a>(
        &mut self,
        rest: &SurfaceMesh,
        material: impl Fn(u32) -> &'a ClothMaterial,
        band: &ElasticBand,
    ) {
        let none = StretchStiffness { weft: 0.0, warp: 0.0, coupling: 0.0, shear: 0.0 };
        let stiffness = StretchStiffness { warp: band.stiffness, ..none };
        for &(face, along) in &band.faces {
            let face = face as usize;
            let damping = material(rest.faces[face][0]).damping;
            let made = Membrane::new(rest, face, (stiffness, damping), |_| along);
            let Some(mut membrane) = made else { continue };
            for slope in &mut membrane.slopes {
                slope.y /= band.ratio;
            }
            membrane.area *= band.ratio;
            membrane.enter(self.membranes.len(), &mut self.in_membranes);
            self.membranes.push(membrane);
            self.membrane_states.push(MembraneState::default());
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

    /// Contributions to a vertex's row of the matrix, whose blocks are those of the `columns`; others
    /// are left out.
    pub(super) fn contributions(&self, vertex: usize, columns: &[u32]) -> Vec<Contribution> {
        let slot = |v: u32| columns.iter().position(|&column| column == v).map(|slot| slot as u16);
        let mut all = Vec::new();
        for &(element, corner) in &self.in_membranes[vertex] {
            for (other, &v) in self.membranes[element as usize].corners.iter().enumerate() {
                let Some(slot) = slot(v) else { continue };
                let other = other as u8;
                all.push(Contribution { element, corner, other, is_hinge: false, slot });
            }
        }
        for &(element, corner) in &self.in_hinges[vertex] {
            for (other, &v) in self.hinges[element as usize].corners.iter().enumerate() {
                let Some(slot) = slot(v) else { continue };
                let other = other as u8;
                all.push(Contribution { element, corner, other, is_hinge: true, slot });
            }
        }
        all
    }

    /// Linearises at positions, metres, and velocities, m/s, for a step of `dt` seconds: for the impulse
    /// `dt f − dt (dt + damping) K v` and the matrix `dt (dt + damping) K`.
    pub(super) fn linearise(&mut self, at: &[DVec3], velocities: &[DVec3], dt: f64) {
        self.membranes
            .par_iter()
            .zip(&mut self.membrane_states)
            .with_min_len(GRAIN)
            .for_each(|(membrane, state)| *state = membrane.state(at, velocities, dt));
        self.hinges
            .par_iter()
            .zip(&mut self.hinge_states)
            .with_min_len(GRAIN)
            .for_each(|(hinge, state)| *state = hinge.state(at, velocities, dt));
    }

    /// Impulse `dt f − dt (dt + damping) K v` on a vertex in the linearised state, N·s.
    pub(super) fn impulse(&self, vertex: usize) -> DVec3 {
        let mut impulse = DVec3::ZERO;
        for &(element, corner) in &self.in_membranes[vertex] {
            let slope = self.membranes[element as usize].slopes[corner as usize];
            let [weft, warp] = self.membrane_states[element as usize].pulls;
            impulse -= weft * slope.x + warp * slope.y;
        }
        for &(element, corner) in &self.in_hinges[vertex] {
            let HingeState { gradients, moment, .. } = &self.hinge_states[element as usize];
            impulse -= gradients[corner as usize].as_dvec3() * *moment;
        }
        impulse
    }

    /// Adds contributions, derivatives of negative forces times `dt (dt + damping)`, to the blocks of a
    /// row, kg. The negative curvature of compressed cloth is left out.
    pub(super) fn add_stiffness(&self, contributions: &[Contribution], row: &mut [Mat3]) {
        for &Contribution { element, corner, other, is_hinge, slot } in contributions {
            let (element, corner, other) = (element as usize, corner as usize, other as usize);
            row[slot as usize] += if is_hinge {
                let gradients = &self.hinge_states[element].gradients;
                let own = gradients[corner] * self.hinge_states[element].weight;
                outer_single(own, gradients[other])
            } else {
                self.membranes[element].block(&self.membrane_states[element], corner, other)
            };
        }
    }

    /// Elastic energy at the positions `at`, joules.
    pub(super) fn energy(&self, at: &[DVec3]) -> f64 {
        let stretch = self.membranes.iter().map(|membrane| {
            let [weft, warp] = membrane.images(at);
            let strain = strain(weft, warp);
            let stress = membrane.stress(strain);
            0.5 * membrane.area * strain.iter().zip(stress).map(|(e, s)| e * s).sum::<f64>()
        });
        let bend = self.hinges.iter().map(|hinge| {
            let change = dihedral(hinge.corners.map(|v| at[v as usize]))
                .map_or(0.0, |(angle, _)| hinge.change(angle));
            0.5 * hinge.stiffness * change * change
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

/// The matrix `a bᵀ` in single precision.
fn outer_single(a: Vec3, b: Vec3) -> Mat3 {
    Mat3::from_cols(a * b.x, a * b.y, a * b.z)
}

/// Bending stiffness of two layers of cloth that do not slide on each other, relative to one: it grows
/// with the cube of the thickness.
const BONDED: f64 = 8.0;

impl Membrane {
    /// A face of the surface `rest` with the direction of the warp for its normal, a unit vector in its
    /// plane; nothing if it has no area.
    fn new(
        rest: &SurfaceMesh,
        face: usize,
        (stiffness, damping): (StretchStiffness, f64),
        warp: impl Fn(DVec3) -> DVec3,
    ) -> Option<Self> {
        let [a, b, c] = rest.corners(face);
        let cross = (b - a).cross(c - a);
        let normal = cross.try_normalize()?;
        let warp = warp(normal);
        let weft = warp.cross(normal);
        let slope = |from: DVec3, to: DVec3| {
            let across = normal.cross(to - from) / cross.length();
            DVec2::new(across.dot(weft), across.dot(warp))
        };
        Some(Self {
            corners: rest.faces[face],
            slopes: [slope(b, c), slope(c, a), slope(a, b)],
            area: 0.5 * cross.length(),
            stiffness,
            damping,
        })
    }

    /// Enters the membrane, the `element` of its list, among the uses of its corners.
    fn enter(&self, element: usize, uses: &mut [Vec<(u32, u8)>]) {
        for (corner, &v) in self.corners.iter().enumerate() {
            uses[v as usize].push((element as u32, corner as u8));
        }
    }

    /// Images of the unit vectors along weft and warp under a map of the corners.
    fn images(&self, of: &[DVec3]) -> [DVec3; 2] {
        let (mut weft, mut warp) = (DVec3::ZERO, DVec3::ZERO);
        for (&v, slope) in self.corners.iter().zip(self.slopes) {
            weft += of[v as usize] * slope.x;
            warp += of[v as usize] * slope.y;
        }
        [weft, warp]
    }

    fn stress(&self, [e0, e1, e2]: [f64; 3]) -> [f64; 3] {
        let c = &self.stiffness;
        [c.weft * e0 + c.coupling * e1, c.coupling * e0 + c.warp * e1, c.shear * e2]
    }

    fn state(&self, at: &[DVec3], velocities: &[DVec3], dt: f64) -> MembraneState {
        let lag = dt * (dt + self.damping);
        let [weft, warp] = self.images(at);
        let stress = self.stress(strain(weft, warp));
        let tension = positive_part(stress);
        let [weft_rate, warp_rate] = self.images(velocities);
        let rates =
            [weft.dot(weft_rate), warp.dot(warp_rate), weft.dot(warp_rate) + warp.dot(weft_rate)];
        let along = |[s0, s1, s2]: [f64; 3], weft: DVec3, warp: DVec3| {
            [weft * s0 + warp * s2, warp * s1 + weft * s2]
        };
        let elastic = along(stress, weft, warp);
        let material = along(self.stress(rates), weft, warp);
        let geometric = along(tension, weft_rate, warp_rate);
        let pull = |i: usize| (elastic[i] * dt + (material[i] + geometric[i]) * lag) * self.area;
        MembraneState {
            weft: weft.as_vec3(),
            warp: warp.as_vec3(),
            tension: tension.map(|t| t as f32),
            weight: (self.area * lag) as f32,
            pulls: [pull(0), pull(1)],
        }
    }

    /// Derivative of the negative force on corner `i` by the position of corner `j`, times
    /// `dt (dt + damping)`.
    fn block(&self, state: &MembraneState, i: usize, j: usize) -> Mat3 {
        let (p, q) = (self.slopes[i].as_vec2() * state.weight, self.slopes[j].as_vec2());
        let MembraneState { weft, warp, tension: [t0, t1, t2], .. } = *state;
        let [c_weft, c_warp, c_coupling, c_shear] = {
            let c = &self.stiffness;
            [c.weft, c.warp, c.coupling, c.shear].map(|c| c as f32)
        };
        let geometric = p.x * q.x * t0 + p.y * q.y * t1 + (p.x * q.y + p.y * q.x) * t2;
        let (shear_p, shear_q) = (warp * p.x + weft * p.y, warp * q.x + weft * q.y);
        let along_weft = weft * (c_weft * q.x * p.x) + warp * (c_coupling * q.y * p.x);
        let along_warp = weft * (c_coupling * q.x * p.y) + warp * (c_warp * q.y * p.y);
        let material = outer_single(weft, along_weft)
            + outer_single(warp, along_warp)
            + outer_single(shear_p, shear_q * c_shear);
        Mat3::from_diagonal(Vec3::splat(geometric)) + material
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
    fn state(&self, at: &[DVec3], velocities: &[DVec3], dt: f64) -> HingeState {
        let lag = dt * (dt + self.damping);
        let corners = self.corners.map(|v| at[v as usize]);
        let Some((angle, gradients)) = dihedral(corners) else { return HingeState::default() };
        let moving = gradients.iter().zip(self.corners);
        let rate: f64 = moving.map(|(gradient, v)| gradient.dot(velocities[v as usize])).sum();
        HingeState {
            gradients: gradients.map(DVec3::as_vec3),
            moment: self.stiffness * (dt * self.change(angle) + lag * rate),
            weight: (self.stiffness * lag) as f32,
        }
    }

    /// Difference of an angle from the one at rest, within half a turn.
    fn change(&self, angle: f64) -> f64 {
        let turn = std::f64::consts::TAU;
        (angle - self.rest + 0.5 * turn).rem_euclid(turn) - 0.5 * turn
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
