use std::ops::Range;

use glam::{DMat3, DVec3};

use super::{
    contact::{Contact, Contacts},
    elastic::{ElasticForces, outer},
    implicit::{ImplicitStep, PointForce},
    material::ClothMaterial,
    reinforce::ElasticBand,
    self_collision::{SelfCollision, crossings},
};
use crate::{Error, Result};
use cape_core::geometry::{SurfaceIndex, SurfaceMesh};

/// An edge and its rest length, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Edge {
    ends: [u32; 2],
    rest: f64,
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
    /// Positions at rest, metres.
    rest: Vec<DVec3>,
    inverse_masses: Vec<f64>,
    edges: Vec<Edge>,
    elastic: ElasticForces,
    solver: ImplicitStep,
    /// Density of the air, kg/m³.
    air: f64,
    attachments: Vec<Attachment>,
    /// Materials of the layers, and the layer of each vertex.
    materials: Vec<ClothMaterial>,
    layers: Vec<u8>,
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
        Self::layered(&[(surface, material)])
    }

    /// Several sheets in one: surfaces at rest and their materials, whose vertices follow one another.
    /// [`with_self_collision`](Self::with_self_collision) keeps each on its side of the others.
    ///
    /// # Errors
    /// If there are more than 255 sheets, or a material is out of range.
    ///
    /// ```
    /// use cape_cloth::{Cloth, ClothMaterial};
    /// use cape_core::geometry::primitives::sphere;
    ///
    /// let [inner, outer] = [sphere(0.1, 1), sphere(0.12, 1)];
    /// let cloth = Cloth::layered(&[(&inner, &ClothMaterial::RIB), (&outer, &ClothMaterial::DENIM)])?;
    /// assert_eq!(cloth.positions.len(), inner.vertices.len() + outer.vertices.len());
    /// assert!(cloth.mass(inner.vertices.len()) > cloth.mass(0));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn layered(sheets: &[(&SurfaceMesh, &ClothMaterial)]) -> Result<Self> {
        if sheets.len() > usize::from(u8::MAX) {
            let message = format!("cloth: {} layers, expected at most {}", sheets.len(), u8::MAX);
            return Err(Error::argument(message));
        }
        let surface = &joined(sheets.iter().map(|sheet| sheet.0));
        let mut layers = Vec::with_capacity(surface.vertices.len());
        for (layer, (sheet, material)) in sheets.iter().enumerate() {
            material.check()?;
            layers.extend(std::iter::repeat_n(layer as u8, sheet.vertices.len()));
        }
        let material = |v: u32| sheets[usize::from(layers[v as usize])].1;
        let count = surface.vertices.len();
        let mut masses = vec![0.0; count];
        for (face, corners) in surface.faces.iter().enumerate() {
            let [a, b, c] = surface.corners(face);
            let mass = material(corners[0]).density * (b - a).cross(c - a).length() / 6.0;
            for &corner in corners {
                masses[corner as usize] += mass;
            }
        }
        let inverse = |&mass: &f64| if mass > 0.0 { 1.0 / mass } else { 0.0 };
        let length =
            |a: u32, b: u32| surface.vertices[a as usize].distance(surface.vertices[b as usize]);
        let edges = surface.edges().into_iter();
        let elastic = ElasticForces::new(surface, material);
        Ok(Self {
            positions: surface.vertices.clone(),
            rest: surface.vertices.clone(),
            velocities: vec![DVec3::ZERO; count],
            inverse_masses: masses.iter().map(inverse).collect(),
            edges: edges.map(|ends| Edge { ends, rest: length(ends[0], ends[1]) }).collect(),
            solver: ImplicitStep::new(&elastic),
            elastic,
            air: 0.0,
            attachments: Vec::new(),
            materials: sheets.iter().map(|sheet| *sheet.1).collect(),
            layers,
            faces: surface.faces.clone(),
            contacts: Contacts::new(count, surface.faces.len()),
            folds: None,
            limit: f64::INFINITY,
        })
    }

    /// Makes the cloth double where the shares of vertices, `[vertices]`, 0 to 1, are 1, as in hems: twice
    /// the mass, and the bending stiffness of two layers that do not slide on each other, eight times that
    /// of one. Hems are sewn to give in the plane, where the stiffness stays that of one layer.
    ///
    /// ```
    /// use cape_cloth::{Cloth, ClothMaterial};
    /// use cape_core::geometry::primitives::sphere;
    ///
    /// let single = Cloth::new(&sphere(0.1, 1), &ClothMaterial::DENIM)?;
    /// let double = single.clone().with_double(&vec![1.0; single.positions.len()]);
    /// assert_eq!(double.mass(0), 2.0 * single.mass(0));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    #[must_use]
    pub fn with_double(mut self, shares: &[f64]) -> Self {
        for (inverse, share) in self.inverse_masses.iter_mut().zip(shares) {
            *inverse /= 1.0 + share;
        }
        self.elastic.double(shares);
        self
    }

    /// Sews elastic onto faces of the cloth, such as those of cuffs.
    #[must_use]
    pub fn with_elastic(mut self, band: &ElasticBand) -> Self {
        let rest = SurfaceMesh { vertices: self.rest.clone(), faces: self.faces.clone() };
        let material = |v: u32| &self.materials[usize::from(self.layers[v as usize])];
        self.elastic.gather(&rest, material, band);
        self.solver = ImplicitStep::new(&self.elastic);
        self
    }

    /// Enables self-collision: vertices keep `distance` metres from faces and edges from edges, or
    /// their distance in the rest surface `rest` if that is less. Between layers, and by
    /// [`with_layer_collision`](Self::with_layer_collision) in all, the materials' thicknesses count.
    #[must_use]
    pub fn with_self_collision(mut self, rest: &SurfaceMesh, distance: f64) -> Self {
        let distances = vec![distance.max(0.0); self.materials.len()];
        self.folds = Some(SelfCollision::new(rest, self.layers.clone(), distances));
        self
    }

    /// Enables self-collision at the thicknesses of the materials, within layers and between them.
    #[must_use]
    pub fn with_layer_collision(mut self) -> Self {
        let rest = SurfaceMesh { vertices: self.rest.clone(), faces: self.faces.clone() };
        let thicknesses = self.materials.iter().map(|material| material.thickness).collect();
        self.folds = Some(SelfCollision::new(&rest, self.layers.clone(), thicknesses));
        self
    }

    /// Limits the elongation of edges to the share `limit` of their rest lengths. Contact with the body
    /// is resolved after it: cloth that has no room stretches further rather than penetrate the body.
    #[must_use]
    pub fn with_strain_limit(mut self, limit: f64) -> Self {
        self.limit = limit.max(0.0);
        self
    }

    /// Adds the drag of still air of a density in kg/m³ (1.2 at sea level) against movement along the
    /// normals, with a coefficient of 1.
    #[must_use]
    pub fn with_air(mut self, density: f64) -> Self {
        self.air = density.max(0.0);
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

    /// One linearly implicit step of `dt` seconds, then contacts, self-collisions and the strain limit.
    /// `gravity` is in m/s². `body` is an obstacle and the times within its frame before and after the
    /// step, each 0 to 1. Vertices move by at most 15 mm in a step.
    pub fn step(&mut self, dt: f64, gravity: DVec3, body: Option<(&SurfaceIndex, [f64; 2])>) {
        let before = self.positions.clone();
        if let Some((solid, times)) = body {
            self.contacts.advance(solid, times);
        }
        self.elastic.linearise(&before, &self.velocities, dt);
        let mut points = self.point_forces(gravity);
        let holds = self.hold(&mut points, dt);
        let changes =
            self.solver.solve(&self.elastic, (&self.inverse_masses, &self.velocities), &points, dt);
        // No vertex passes through the surface of a limb and beyond the reach of contact in one step.
        let fastest = Contact::REACH * 0.75 / dt;
        for (v, change) in changes.into_iter().enumerate() {
            if self.inverse_masses[v] > 0.0 {
                let velocity = (self.velocities[v] + change).clamp_length_max(fastest);
                self.velocities[v] = velocity;
                self.positions[v] += velocity * dt;
            }
        }
        let velocities = &self.velocities;
        self.contacts.bear(holds.iter().zip(velocities).map(|(hold, velocity)| {
            hold.map_or(0.0, |(outward, speed, weight)| weight * (speed - velocity.dot(outward)))
        }));
        self.resolve_contacts(body, &before, dt);
        self.apply_strain_limits();
        self.resolve_folds(&before, dt);
        self.apply_strain_limits();
        self.resolve_contacts(body, &before, dt);
        for ((x, v), before) in self.positions.iter().zip(&mut self.velocities).zip(before) {
            *v = (*x - before) / dt;
        }
        if body.is_some() {
            self.contacts.stop(&mut self.velocities, dt);
        }
    }

    /// Pushes the cloth out of the body, an obstacle with the times within its frame before and after
    /// the step. `before` are the positions before the step.
    fn resolve_contacts(
        &mut self,
        body: Option<(&SurfaceIndex, [f64; 2])>,
        before: &[DVec3],
        dt: f64,
    ) {
        let Some((solid, [from, now])) = body else { return };
        let contact = |material: &ClothMaterial| {
            let ClothMaterial { friction, thickness, .. } = *material;
            Contact { friction, thickness, from, now, dt }
        };
        let contacts: Vec<Contact> = self.materials.iter().map(contact).collect();
        let sheet = (&self.inverse_masses[..], &self.faces[..], &self.layers[..]);
        self.contacts.resolve(&contacts, solid, before, &mut self.positions, sheet);
    }

    /// Separates parts of the cloth, after a step of `dt` seconds from the positions `before`.
    fn resolve_folds(&mut self, before: &[DVec3], dt: f64) {
        let Some(folds) = &mut self.folds else { return };
        let friction = self.materials.iter().map(|material| material.friction).sum::<f64>()
            / self.materials.len() as f64;
        folds.resolve(before, &mut self.positions, &self.inverse_masses, (friction, dt));
    }

    /// Adds the contacts of vertices with the body to the forces of a step of `dt` seconds: they keep the
    /// body's velocity along the gradient of the distance; along the surface acts Coulomb friction at
    /// the impulse of the last step and the slip expected in this one. Returns, for each vertex in
    /// contact, the gradient, the body's speed along it, m/s, and the impulse by a difference of the
    /// speeds, kg.
    fn hold(&self, points: &mut [PointForce], dt: f64) -> Vec<Option<(DVec3, f64, f64)>> {
        let stiffest = |m: &ClothMaterial| m.stretch.weft.max(m.stretch.warp);
        let holds = self.contacts.holds().enumerate().map(|(v, hold)| {
            let hold = hold.filter(|_| self.inverse_masses[v] > 0.0)?;
            let (outward, along) = (hold.outward, hold.carried / dt);
            let material = &self.materials[usize::from(self.layers[v])];
            let mass = 1.0 / self.inverse_masses[v] + dt * dt * stiffest(material);
            let weight = RIGID * mass;
            let slip = hold.slip.map_or(0.0, |[slip, gain]| (slip + gain).length());
            let rough = hold.friction * hold.impulse / slip.max(CREEP);
            let held = outer(outward, outward);
            let drag = held * (weight / dt) + (DMat3::IDENTITY - held) * (rough / dt);
            let point = &mut points[v];
            point.drag += drag;
            point.drive = drag * along;
            point.held = Some((outward, along.dot(outward)));
            Some((outward, along.dot(outward), weight))
        });
        holds.collect()
    }

    /// Gravity, attachments and drag.
    fn point_forces(&self, gravity: DVec3) -> Vec<PointForce> {
        let mut points: Vec<PointForce> = self
            .inverse_masses
            .iter()
            .map(|&w| PointForce {
                force: if w > 0.0 { gravity / w } else { DVec3::ZERO },
                drag: DMat3::ZERO,
                ..PointForce::default()
            })
            .collect();
        for &Attachment { vertex, to, compliance } in &self.attachments {
            let stiffness = 1.0 / compliance.max(LEAST_COMPLIANCE);
            let point = &mut points[vertex as usize];
            point.force += (to - self.positions[vertex as usize]) * stiffness;
            point.stiffness += stiffness;
        }
        if self.air > 0.0 {
            for face in &self.faces {
                let [a, b, c] = face.map(|v| self.positions[v as usize]);
                let cross = (b - a).cross(c - a);
                let Some(normal) = cross.try_normalize() else { continue };
                let velocity: DVec3 = face.iter().map(|&v| self.velocities[v as usize]).sum();
                let speed = velocity.dot(normal).abs() / 3.0;
                // A third of ½ ρ A |v·n| for each corner.
                let share = outer(normal, normal * (self.air * speed * cross.length() / 12.0));
                for &v in face {
                    points[v as usize].drag += share;
                }
            }
        }
        points
    }

    /// Shortens edges beyond the strain limit, once in their order and once in reverse.
    fn apply_strain_limits(&mut self) {
        if self.limit.is_infinite() {
            return;
        }
        let order = 0..self.edges.len();
        for reversed in [false, true] {
            for index in order.clone() {
                let at = if reversed { order.end - 1 - index } else { index };
                let Edge { ends: [a, b], rest } = self.edges[at];
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
        vertex_energy + self.elastic.energy(&self.positions)
    }

    /// Mean absolute strain of the edges, and the largest elongation, both relative to the rest
    /// lengths.
    pub fn strain(&self) -> [f64; 2] {
        self.strain_within(0..self.positions.len())
    }

    /// [`strain`](Self::strain) of the edges between some vertices, such as those of one layer.
    pub fn strain_within(&self, vertices: Range<usize>) -> [f64; 2] {
        let (mut sum, mut largest, mut count) = (0.0, 0.0f64, 0usize);
        for edge in &self.edges {
            let [a, b] = edge.ends.map(|v| v as usize);
            if vertices.contains(&a) && vertices.contains(&b) {
                let length = self.positions[a].distance(self.positions[b]);
                let change = length / edge.rest.max(f64::MIN_POSITIVE) - 1.0;
                (sum, largest, count) = (sum + change.abs(), largest.max(change), count + 1);
            }
        }
        [sum / count.max(1) as f64, largest]
    }

    /// Number of intersections of edges with faces.
    pub fn crossings(&self) -> usize {
        let edges: Vec<[u32; 2]> = self.edges.iter().map(|edge| edge.ends).collect();
        crossings(&self.faces, &edges, &self.positions)
    }
}

/// Surfaces in one, whose vertices follow one another.
pub(super) fn joined<'a>(surfaces: impl Iterator<Item = &'a SurfaceMesh>) -> SurfaceMesh {
    let mut all = SurfaceMesh::default();
    for surface in surfaces {
        let first = all.vertices.len() as u32;
        all.vertices.extend(&surface.vertices);
        all.faces.extend(surface.faces.iter().map(|face| face.map(|v| v + first)));
    }
    all
}

/// Resistance of a contact to a difference of speeds along the gradient of the distance, relative to the
/// resistance of the vertex.
const RIGID: f64 = 30.0;

/// Speed of slip below which friction is proportional to it, m/s.
const CREEP: f64 = 1e-3;

/// Least compliance of an attachment, m/N.
const LEAST_COMPLIANCE: f64 = 1e-6;
