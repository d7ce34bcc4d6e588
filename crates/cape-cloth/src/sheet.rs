use std::collections::HashMap;

use glam::DVec3;
use rayon::prelude::*;
use serde::Serialize;

use super::{
    contact::{Contact, Contacts},
    self_collision::{SelfCollision, crossings},
};
use crate::{Error, Result};
use cape_core::geometry::{SurfaceIndex, SurfaceMesh};

/// Material of a cloth.
///
/// ```
/// use cape_cloth::ClothMaterial;
///
/// let denim = ClothMaterial { density: 0.1, ..ClothMaterial::default() };
/// denim.check()?;
/// // Densities are on a logarithmic scale.
/// assert_eq!(denim.numbers()[0], -1.0);
/// let nothing = ClothMaterial { density: 0.0, ..denim };
/// assert!(nothing.check().unwrap_err().to_string().contains("density"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ClothMaterial {
    /// Mass per area, kg/m².
    pub density: f64,
    /// Compliance of the edges, m/N, for stretch and shear; 0 is inextensible.
    pub stretch: f64,
    /// Compliance between the opposite corners of neighbouring triangles, m/N, for bending.
    pub bend: f64,
    /// Decay rate of the velocity, 1/s.
    pub damping: f64,
    /// Coefficient of Coulomb friction against the body.
    pub friction: f64,
    /// Distance from the body, metres.
    pub thickness: f64,
}

impl Default for ClothMaterial {
    /// Cotton jersey.
    fn default() -> Self {
        Self {
            density: 0.2,
            stretch: 1e-5,
            bend: 0.05,
            damping: 1.0,
            friction: 0.3,
            thickness: 0.003,
        }
    }
}

impl ClothMaterial {
    /// Semantic parameters for regression: decimal logarithms of density, stretch and bend, then
    /// damping and friction, `[5]`.
    pub fn numbers(&self) -> [f64; 5] {
        let log = |x: f64| x.max(1e-12).log10();
        [log(self.density), log(self.stretch), log(self.bend), self.damping, self.friction]
    }

    /// Checks the ranges of the parameters.
    ///
    /// # Errors
    /// If one is out of range; the error has its name.
    pub fn check(&self) -> Result<()> {
        let Self { density, stretch, bend, damping, friction, thickness } = *self;
        for (name, value, least) in [
            ("density", density, f64::MIN_POSITIVE),
            ("stretch", stretch, 0.0),
            ("bend", bend, 0.0),
            ("damping", damping, 0.0),
            ("friction", friction, 0.0),
            ("thickness", thickness, 0.0),
        ] {
            if !(value.is_finite() && value >= least) {
                return Err(Error::argument(format!(
                    "material: {name} {value}, expected {}",
                    if least > 0.0 { "above 0" } else { "0 or more" }
                )));
            }
        }
        Ok(())
    }
}

/// A distance constraint between two vertices.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Spring {
    ends: [u32; 2],
    rest: f64,
    compliance: f64,
}

/// A soft constraint of a vertex to a position.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Attachment {
    vertex: u32,
    to: DVec3,
    compliance: f64,
}

/// A moving sheet of triangles.
///
/// ```
/// use cape_cloth::{Cloth, ClothMaterial};
/// use cape_core::geometry::primitives::sphere;
/// use glam::DVec3;
///
/// // A sheet in free fall keeps its shape.
/// let material = ClothMaterial { damping: 0.0, ..ClothMaterial::default() };
/// let mut cloth = Cloth::new(&sphere(0.1, 0), &material)?;
/// let gravity = DVec3::NEG_Y * 9.81;
/// (0..100).for_each(|_| cloth.step(0.001, gravity, None));
/// assert!(cloth.velocities.iter().all(|v| (*v - 0.1 * gravity).length() < 1e-6));
/// assert!(cloth.strain()[1] < 1e-6);
/// assert_eq!(cloth.crossings(), 0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct Cloth {
    /// Positions, metres, `[vertices]`.
    pub positions: Vec<DVec3>,
    /// Velocities, m/s, `[vertices]`.
    pub velocities: Vec<DVec3>,
    inverse_masses: Vec<f64>,
    /// Edges, then opposite corners of neighbouring triangles.
    springs: Vec<Spring>,
    edges: usize,
    attachments: Vec<Attachment>,
    material: ClothMaterial,
    faces: Vec<[u32; 3]>,
    contacts: Contacts,
    folds: Option<SelfCollision>,
    /// Largest relative elongation of an edge.
    limit: f64,
}

impl Cloth {
    /// A sheet at rest with the rest lengths of `surface`. Each vertex has a third of the mass of
    /// its faces.
    ///
    /// # Errors
    /// If the material is out of range.
    pub fn new(surface: &SurfaceMesh, material: &ClothMaterial) -> Result<Self> {
        material.check()?;
        let count = surface.vertices.len();
        let mut masses = vec![0.0; count];
        for (face, corners) in surface.faces.iter().enumerate() {
            let [a, b, c] = surface.corners(face);
            let mass = material.density * (b - a).cross(c - a).length() / 6.0;
            for &corner in corners {
                masses[corner as usize] += mass;
            }
        }
        let inverse = |&mass: &f64| if mass > 0.0 { 1.0 / mass } else { 0.0 };
        let length =
            |a: u32, b: u32| surface.vertices[a as usize].distance(surface.vertices[b as usize]);
        let edges = surface.edges();
        let edge_count = edges.len();
        let stretch = edges.into_iter().map(|[a, b]| Spring {
            ends: [a, b],
            rest: length(a, b),
            compliance: material.stretch,
        });
        let bend = far_corners(&surface.faces).into_iter().map(|[a, b]| Spring {
            ends: [a, b],
            rest: length(a, b),
            compliance: material.bend,
        });
        Ok(Self {
            positions: surface.vertices.clone(),
            velocities: vec![DVec3::ZERO; count],
            inverse_masses: masses.iter().map(inverse).collect(),
            springs: stretch.chain(bend).collect(),
            edges: edge_count,
            attachments: Vec::new(),
            material: *material,
            faces: surface.faces.clone(),
            contacts: Contacts::new(count, surface.faces.len()),
            folds: None,
            limit: f64::INFINITY,
        })
    }

    /// Enables self-collision: vertices keep `distance` metres from faces and edges from edges, or
    /// their distance in the rest surface `rest` if that is less.
    #[must_use]
    pub fn with_self_collision(mut self, rest: &SurfaceMesh, distance: f64) -> Self {
        self.folds = Some(SelfCollision::new(rest, distance.max(0.0)));
        self
    }

    /// Limits the elongation of edges to the share `limit` of their rest lengths. The limit is
    /// applied last in a step: cloth that has no room penetrates the body rather than stretch
    /// further.
    #[must_use]
    pub fn with_strain_limit(mut self, limit: f64) -> Self {
        self.limit = limit.max(0.0);
        self
    }

    /// Fixes a vertex at its position.
    pub fn pin(&mut self, vertex: usize) {
        self.inverse_masses[vertex] = 0.0;
    }

    /// Replaces the soft attachments: pairs of a vertex and a position, metres, with a `compliance`
    /// in m/N.
    pub fn attach(&mut self, places: impl IntoIterator<Item = (u32, DVec3)>, compliance: f64) {
        let attachment = |(vertex, to)| Attachment { vertex, to, compliance };
        self.attachments = places.into_iter().map(attachment).collect();
    }

    /// Mass of a vertex, kg; infinite if it is fixed.
    pub fn mass(&self, vertex: usize) -> f64 {
        1.0 / self.inverse_masses[vertex]
    }

    /// One step of `dt` seconds. Constraints are projected once, which adds `dt²` times the inverse
    /// masses of their ends to their compliance. `gravity` is in m/s². `body` is an obstacle and
    /// the times within its frame before and after the step, each 0 to 1.
    pub fn step(&mut self, dt: f64, gravity: DVec3, body: Option<(&SurfaceIndex, [f64; 2])>) {
        let before = self.positions.clone();
        let decay = (-self.material.damping * dt).exp();
        // Limits the speed, so that no vertex passes through a limb in one step.
        let fastest = Contact::REACH / 4.0 / dt;
        for ((x, v), &w) in
            self.positions.iter_mut().zip(&mut self.velocities).zip(&self.inverse_masses)
        {
            if w > 0.0 {
                *v = (*v * decay + gravity * dt).clamp_length_max(fastest);
                *x += *v * dt;
            }
        }
        self.project(dt);
        if let Some((solid, [from, now])) = body {
            let contact = Contact {
                friction: self.material.friction,
                thickness: self.material.thickness,
                from,
                now,
            };
            let sheet = (&self.inverse_masses[..], &self.faces[..]);
            self.contacts.resolve(&contact, solid, &before, &mut self.positions, sheet);
        }
        if let Some(folds) = &mut self.folds {
            folds.resolve(&before, &mut self.positions, &self.inverse_masses);
        }
        self.apply_strain_limits();
        for ((x, v), before) in self.positions.iter().zip(&mut self.velocities).zip(before) {
            *v = (*x - before) / dt;
        }
    }

    /// Projects distance constraints, then attachments.
    fn project(&mut self, dt: f64) {
        for &Spring { ends: [a, b], rest, compliance } in &self.springs {
            let (a, b) = (a as usize, b as usize);
            let (wa, wb) = (self.inverse_masses[a], self.inverse_masses[b]);
            let along = self.positions[a] - self.positions[b];
            let length = along.length();
            let sum = wa + wb + compliance / (dt * dt);
            if sum == 0.0 || length == 0.0 {
                continue;
            }
            let push = along * ((rest - length) / (length * sum));
            self.positions[a] += push * wa;
            self.positions[b] -= push * wb;
        }
        for &Attachment { vertex, to, compliance } in &self.attachments {
            let w = self.inverse_masses[vertex as usize];
            let x = &mut self.positions[vertex as usize];
            if w > 0.0 {
                *x += (to - *x) * (w / (w + compliance / (dt * dt)));
            }
        }
    }

    /// Shortens edges beyond the strain limit, in alternating order.
    fn apply_strain_limits(&mut self) {
        const SWEEPS: usize = 4;
        if self.limit.is_infinite() {
            return;
        }
        for sweep in 0..SWEEPS {
            for index in 0..self.edges {
                let at = if sweep % 2 == 0 { index } else { self.edges - 1 - index };
                let Spring { ends: [a, b], rest, .. } = self.springs[at];
                let (a, b) = (a as usize, b as usize);
                let along = self.positions[a] - self.positions[b];
                let length = along.length();
                let longest = rest * (1.0 + self.limit);
                let (wa, wb) = (self.inverse_masses[a], self.inverse_masses[b]);
                if length > longest && wa + wb > 0.0 {
                    let push = along * ((longest - length) / (length * (wa + wb)));
                    self.positions[a] += push * wa;
                    self.positions[b] -= push * wb;
                }
            }
        }
    }

    /// Sum of kinetic, gravitational and elastic energy, joules; heights are relative to the origin.
    pub fn energy(&self, gravity: DVec3) -> f64 {
        let moving = self.inverse_masses.iter().enumerate().filter(|&(_, &w)| w > 0.0);
        let vertex_energy: f64 = moving
            .map(|(v, w)| {
                let kinetic = 0.5 * self.velocities[v].length_squared();
                (kinetic - gravity.dot(self.positions[v])) / w
            })
            .sum();
        let elastic = self.springs.iter().filter(|spring| spring.compliance > 0.0).map(|spring| {
            let [a, b] = spring.ends.map(|v| self.positions[v as usize]);
            0.5 * (a.distance(b) - spring.rest).powi(2) / spring.compliance
        });
        vertex_energy + elastic.sum::<f64>()
    }

    /// Mean absolute strain of the edges, and the largest elongation, both relative to the rest
    /// lengths.
    pub fn strain(&self) -> [f64; 2] {
        let edges = &self.springs[..self.edges];
        let (mut sum, mut largest) = (0.0, 0.0f64);
        for spring in edges {
            let [a, b] = spring.ends.map(|v| self.positions[v as usize]);
            let change = a.distance(b) / spring.rest.max(f64::MIN_POSITIVE) - 1.0;
            (sum, largest) = (sum + change.abs(), largest.max(change));
        }
        [sum / edges.len().max(1) as f64, largest]
    }

    /// Number of intersections of edges with faces.
    pub fn crossings(&self) -> usize {
        let edges: Vec<[u32; 2]> = self.springs[..self.edges].iter().map(|s| s.ends).collect();
        crossings(&self.faces, &edges, &self.positions)
    }

    /// Depths inside the body of vertices, then of centres of faces, metres; 0 outside.
    pub fn depths(&self, body: &SurfaceIndex) -> Vec<f64> {
        let centre =
            |face: &[u32; 3]| face.iter().map(|&v| self.positions[v as usize]).sum::<DVec3>() / 3.0;
        let centres: Vec<DVec3> = self.faces.iter().map(centre).collect();
        let points = self.positions.par_iter().chain(&centres);
        let depth = |&x: &DVec3| {
            body.closest(x, DEEPEST).map_or(0.0, |near| (-near.signed_distance).max(0.0))
        };
        points.map(depth).collect()
    }
}

/// Bound of the depth inside a body, metres.
const DEEPEST: f64 = 0.2;

/// Opposite corners of the two faces of each inner edge.
fn far_corners(faces: &[[u32; 3]]) -> Vec<[u32; 2]> {
    let mut seen: HashMap<[u32; 2], u32> = HashMap::new();
    let mut pairs = Vec::new();
    for face in faces {
        for i in 0..3 {
            let (p, q, far) = (face[i], face[(i + 1) % 3], face[(i + 2) % 3]);
            if let Some(other) = seen.insert([p.min(q), p.max(q)], far) {
                pairs.push([other, far]);
            }
        }
    }
    pairs
}
