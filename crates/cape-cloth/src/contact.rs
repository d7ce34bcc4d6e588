use std::collections::HashMap;

use glam::{DVec3, IVec3};
use rayon::prelude::*;

use cape_core::geometry::{ClosestPoint, SurfaceIndex, closest_on_triangle};

/// Parameters of the contact of cloth with a body in one step, at vertices and at the centres of
/// faces.
///
/// ```
/// use cape_cloth::{Contact, ClothMaterial};
///
/// // Contact of the default material in the first half of a frame.
/// let ClothMaterial { friction, thickness, .. } = ClothMaterial::default();
/// let contact = Contact { friction, thickness, from: 0.0, now: 0.5, dt: 1.0 / 60.0 };
/// assert!(contact.thickness < Contact::REACH);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// Coefficient of Coulomb friction.
    pub friction: f64,
    /// Distance that vertices keep from the body, metres; centres of faces keep half of it.
    pub thickness: f64,
    /// Time within the frame before the step, 0 to 1.
    pub from: f64,
    /// Time within the frame after the step, 0 to 1.
    pub now: f64,
    /// Duration of the step, seconds.
    pub dt: f64,
}

impl Contact {
    /// Greatest depth inside the body from which a vertex is pushed out, metres. Deeper vertices are
    /// between limbs that touch; their neighbours pull them out on the side that they came from.
    pub const REACH: f64 = 0.02;
}

/// Closest point on the body of a point of the cloth in an earlier step.
///
/// The whole body is searched again only when point and body may have approached by the distance found
/// last; in between, points in contact are compared with the neighbourhood of their closest face.
#[derive(Debug, Clone, Copy, Default)]
struct ContactCache {
    face: Option<u32>,
    /// Gradient of the distance from the body in the last step with a closest face.
    outward: DVec3,
    /// Lower bound of the distance from the body at the last search, metres.
    distance: f64,
    /// Position of the point relative to the reference at the last search, metres.
    at: DVec3,
    /// Largest path of the surrounding body relative to the reference since the last search, metres.
    travelled: f64,
    /// Largest displacement of the surrounding body in a frame, metres, and that frame.
    rate: f64,
    frame: u64,
    /// Contact with the body after the step, if there is one.
    held: Option<Hold>,
}

/// A vertex that rests on the body: it follows the body along the gradient of the distance, and with
/// friction along the surface.
#[derive(Debug, Clone, Copy)]
pub(super) struct Hold {
    /// Gradient of the distance from the body.
    pub outward: DVec3,
    /// Displacement of the point of the body in the step, metres.
    pub carried: DVec3,
    /// Impulse between body and vertex in the last step, N·s.
    pub impulse: f64,
    /// Coefficient of Coulomb friction.
    pub friction: f64,
    /// Velocity along the surface relative to the body, m/s, and its change in the last step, once there
    /// was a step in contact.
    pub slip: Option<[DVec3; 2]>,
    face: u32,
    barycentric: [f64; 3],
}

/// Approach of a point to another part of the body between searches of the whole body, metres.
const UNSEEN: f64 = 0.004;

/// Distance beyond the thickness within which a vertex that the body bears stays in contact, metres.
const NEAR: f64 = 2e-4;

/// Displacement that resolves a contact: `outward` times `depth`, metres, and the point of the body.
/// The depth is negative for vertices beyond the thickness.
#[derive(Debug, Clone, Copy)]
struct ContactCorrection {
    depth: f64,
    outward: DVec3,
    face: u32,
    barycentric: [f64; 3],
}

/// Motion of a body within a frame, relative to its mean motion.
#[derive(Debug, Clone, Default)]
struct BodyMovement {
    /// Number of the frame, from 1.
    frame: u64,
    /// Position of the reference, which moves by the mean displacement, metres.
    reference: DVec3,
    /// Displacement of the reference in the frame, metres.
    mean: DVec3,
    /// Largest displacement relative to the mean in cells of [`CELL`] metres.
    cells: HashMap<IVec3, f64>,
    /// Faces that share a corner with each face, and the faces that they belong to.
    around: Vec<Vec<u32>>,
    faces: Vec<[u32; 3]>,
    /// Corners of the faces around each face.
    corners_around: Vec<Vec<u32>>,
    /// Centres of the faces at the end of the step, and the distances of their corners from them, metres.
    spheres: Vec<(DVec3, f64)>,
}

/// Edge of the cells in which the body's motion is bounded, metres.
const CELL: f64 = 0.1;

impl BodyMovement {
    /// Measures the motion of the next frame.
    fn begin(&mut self, body: &SurfaceIndex) {
        self.frame += 1;
        self.cells.clear();
        self.mean = DVec3::ZERO;
        let faces = &body.surface().faces;
        if self.faces != *faces {
            self.faces.clone_from(faces);
            let corners = body.surface().vertex_faces();
            self.around = faces
                .iter()
                .map(|face| {
                    let mut near: Vec<u32> =
                        face.iter().flat_map(|&v| corners[v as usize].iter().copied()).collect();
                    near.sort_unstable();
                    near.dedup();
                    near
                })
                .collect();
            let corners_of = |near: &Vec<u32>| {
                let mut corners: Vec<u32> =
                    near.iter().flat_map(|&face| faces[face as usize]).collect();
                corners.sort_unstable();
                corners.dedup();
                corners
            };
            self.corners_around = self.around.iter().map(corners_of).collect();
        }
        if body.largest_displacement() == 0.0 {
            return;
        }
        let (moves, mean) = displacements(body);
        self.mean = mean;
        for [from, to] in moves {
            let way = (to - from - self.mean).length();
            for t in [0.0, 0.5, 1.0] {
                let most = self.cells.entry(cell(from.lerp(to, t))).or_default();
                *most = most.max(way);
            }
        }
    }

    /// Follows the body to the end of a step.
    fn follow(&mut self, body: &SurfaceIndex) {
        let at = &body.surface().vertices;
        self.spheres.clear();
        self.spheres.extend(self.faces.iter().map(|face| {
            let corners = face.map(|v| at[v as usize]);
            let centre = corners.iter().sum::<DVec3>() / 3.0;
            let squares = corners.map(|corner| corner.distance_squared(centre));
            (centre, squares.into_iter().fold(0.0, f64::max).sqrt())
        }));
    }

    /// Largest displacement relative to the mean of the body within a cell's edge of a point, metres.
    fn around(&self, point: DVec3) -> f64 {
        let centre = cell(point);
        let mut most = 0.0f64;
        for x in -1..=1 {
            for y in -1..=1 {
                for z in -1..=1 {
                    let found = self.cells.get(&(centre + IVec3::new(x, y, z)));
                    most = most.max(found.copied().unwrap_or(0.0));
                }
            }
        }
        most
    }
}

/// Positions of a corner of each face at the ends of the frame, and their mean displacement, metres.
pub(super) fn displacements(body: &SurfaceIndex) -> (Vec<[DVec3; 2]>, DVec3) {
    let corner = |face, t| body.position_at(face, [1.0, 0.0, 0.0], t);
    let moves: Vec<[DVec3; 2]> = (0..body.surface().faces.len() as u32)
        .map(|face| [0.0, 1.0].map(|t| corner(face, t)))
        .collect();
    let sum: DVec3 = moves.iter().map(|[from, to]| *to - *from).sum();
    let mean = sum / moves.len().max(1) as f64;
    (moves, mean)
}

fn cell(point: DVec3) -> IVec3 {
    (point / CELL).floor().as_ivec3()
}

/// Contact caches of a piece of cloth.
#[derive(Debug, Clone, Default)]
pub(super) struct Contacts {
    vertices: Vec<ContactCache>,
    centres: Vec<ContactCache>,
    body: BodyMovement,
    /// Share of the frame since the last contacts.
    share: f64,
}

impl Contacts {
    pub(super) fn new(vertices: usize, faces: usize) -> Self {
        Self {
            vertices: vec![ContactCache::default(); vertices],
            centres: vec![ContactCache::default(); faces],
            body: BodyMovement::default(),
            share: 0.0,
        }
    }

    /// Follows the body through a step from and to a time within its frame, 0 to 1.
    pub(super) fn advance(&mut self, body: &SurfaceIndex, [from, now]: [f64; 2]) {
        if from == 0.0 {
            self.body.begin(body);
        }
        self.body.follow(body);
        self.share += now - from;
        self.body.reference += self.body.mean * (now - from);
        for hold in self.vertices.iter_mut().filter_map(|memory| memory.held.as_mut()) {
            let at = |time| body.position_at(hold.face, hold.barycentric, time);
            hold.carried = at(now) - at(from);
        }
    }

    /// Contacts of the vertices with the body at the beginning of the step, after
    /// [`advance`](Self::advance).
    pub(super) fn holds(&self) -> impl Iterator<Item = Option<Hold>> {
        self.vertices.iter().map(|memory| memory.held)
    }

    /// Sets the impulses between vertices and body in the step, N·s; vertices that the body would have to
    /// pull are released.
    pub(super) fn bear(&mut self, impulses: impl Iterator<Item = f64>) {
        for (memory, impulse) in self.vertices.iter_mut().zip(impulses) {
            if let Some(hold) = &mut memory.held {
                hold.impulse = impulse;
            }
            memory.held.take_if(|hold| hold.impulse <= 0.0);
        }
    }

    /// Velocities after the contacts of a step of `dt` seconds, m/s: vertices that were pushed do not
    /// part from the body, since contact is inelastic.
    pub(super) fn stop(&mut self, velocities: &mut [DVec3], dt: f64) {
        for (velocity, memory) in velocities.iter_mut().zip(&mut self.vertices) {
            if let Some(hold) = &mut memory.held {
                let relative = *velocity - hold.carried / dt;
                let parting = relative.dot(hold.outward);
                *velocity -= hold.outward * parting.max(0.0);
                let slip = relative - hold.outward * parting;
                let gain = hold.slip.map_or(DVec3::ZERO, |[before, _]| slip - before);
                hold.slip = Some([slip, gain]);
            }
        }
    }

    /// Pushes out faces whose centres, then vertices that are closer to the body than the thickness
    /// allows, along the gradient of the distance, and applies Coulomb friction: the tangential
    /// movement of a vertex relative to the body is reduced by at most the friction times its push.
    /// `before` are the positions before the step, metres.
    ///
    /// `contacts` are of the layers of the cloth, `sheet` its inverse masses, 1/kg, faces, and the layer
    /// of each vertex. [`advance`](Self::advance) comes before it in each step.
    pub(super) fn resolve(
        &mut self,
        contacts: &[Contact],
        body: &SurfaceIndex,
        before: &[DVec3],
        positions: &mut [DVec3],
        sheet: (&[f64], &[[u32; 3]], &[u8]),
    ) {
        let (inverse_masses, _, layers) = sheet;
        let movement = &self.body;
        let share = std::mem::take(&mut self.share);
        push_out_faces((&mut self.centres, movement), contacts, body, positions, sheet, share);
        let moving = positions.par_iter_mut().zip(before).zip(inverse_masses).zip(layers);
        moving.zip(&mut self.vertices).filter(|(((_, w), _), _)| **w > 0.0).for_each(
            |((((x, &before), w), &layer), memory)| {
                let contact = &contacts[usize::from(layer)];
                let Contact { friction, thickness, from, now, dt } = *contact;
                let found = memory.push((body, movement), *x, thickness, share);
                let Some(ContactCorrection { depth, outward, face, barycentric }) = found else {
                    memory.held = None;
                    return;
                };
                let borne = memory.held.map_or(0.0, |hold| hold.impulse);
                let slip = memory.held.and_then(|hold| hold.slip);
                if depth <= 0.0 && (depth < -NEAR || borne <= 0.0) {
                    memory.held = None;
                    return;
                }
                let carried = body.position_at(face, barycentric, now)
                    - body.position_at(face, barycentric, from);
                let impulse = borne + depth.max(0.0) / (w * dt);
                memory.held =
                    Some(Hold { outward, carried, impulse, friction, slip, face, barycentric });
                if depth <= 0.0 {
                    return;
                }
                *x += outward * depth;
                // The friction of vertices that the body bore is part of the forces of the step.
                if borne > 0.0 {
                    return;
                }
                let slip = (*x - before) - carried;
                let slip = slip - outward * slip.dot(outward);
                let length = slip.length();
                if length > 0.0 {
                    *x -= slip * (friction * depth / length).min(1.0);
                }
            },
        );
    }
}

/// Barycentric coordinates of a point of a face, and its displacement, metres.
type FacePush = ([f64; 3], DVec3);

/// Moves each vertex by the mean of the pushes of its faces: of their centres, and of vertices of the
/// body that are closer to them than half the thickness, or beyond them.
fn push_out_faces(
    (centres, movement): (&mut [ContactCache], &BodyMovement),
    contacts: &[Contact],
    body: &SurfaceIndex,
    positions: &mut [DVec3],
    (inverse_masses, faces, layers): (&[f64], &[[u32; 3]], &[u8]),
    share: f64,
) {
    let at = &*positions;
    let pushes: Vec<[Option<FacePush>; 2]> = faces
        .par_iter()
        .zip(centres)
        .map(|(corners, memory)| {
            let centre = corners.iter().map(|&v| at[v as usize]).sum::<DVec3>() / 3.0;
            let contact = &contacts[usize::from(layers[corners[0] as usize])];
            let thickness = 0.5 * contact.thickness;
            let push = memory.push((body, movement), centre, thickness, share);
            let push = push.filter(|push| push.depth > 0.0);
            let push = push.map(|push| ([1.0 / 3.0; 3], push.outward * push.depth));
            let triangle = corners.map(|v| at[v as usize]);
            [push, memory.push_off_vertex((body, movement), triangle, thickness)]
        })
        .collect();
    let mut moves = vec![(DVec3::ZERO, 0.0); positions.len()];
    for (corners, pushes) in faces.iter().zip(pushes) {
        for (shares, push) in pushes.into_iter().flatten() {
            // Δx = w_i ∇_i λ with the point's shares of the corners as gradients.
            let weights = corners.map(|v| inverse_masses[v as usize]);
            let total: f64 = weights.iter().zip(shares).map(|(w, share)| w * share * share).sum();
            for ((&v, w), share) in corners.iter().zip(weights).zip(shares) {
                if total > 0.0 && share > 0.0 {
                    let (sum, count) = &mut moves[v as usize];
                    *sum += push * (w * share / total);
                    *count += 1.0;
                }
            }
        }
    }
    for (x, (sum, count)) in positions.iter_mut().zip(moves).filter(|(_, all)| all.1 > 0.0) {
        *x += sum / count;
    }
}

impl ContactCache {
    /// Correction of a point `x` that keeps `thickness` metres from the body, after a `share` of the
    /// frame; nothing for points that are known to be beyond the thickness.
    fn push(
        &mut self,
        (body, movement): (&SurfaceIndex, &BodyMovement),
        x: DVec3,
        thickness: f64,
        share: f64,
    ) -> Option<ContactCorrection> {
        let reach = Contact::REACH.max(thickness);
        if self.frame != movement.frame {
            (self.rate, self.frame) = (movement.around(x), movement.frame);
        }
        self.travelled += self.rate * share;
        let relative = x - movement.reference;
        let approach = relative.distance(self.at) + self.travelled;
        if self.distance - approach > thickness + NEAR {
            return None;
        }
        if let Some(face) = self.face.filter(|_| approach < UNSEEN) {
            let (distance, face, barycentric, away) = closest_around((body, movement), x, face);
            let inside = away.dot(self.outward) < 0.0;
            let distance = if inside { -distance } else { distance };
            if let Some(direction) = away.try_normalize().filter(|_| distance.abs() > 1e-6) {
                self.outward = if inside { -direction } else { direction };
            }
            self.face = Some(face);
            let depth = thickness - distance;
            let outward = self.outward;
            return Some(ContactCorrection { depth, outward, face, barycentric });
        }
        let near = body.closest_from(x, reach, self.face);
        (self.at, self.travelled) = (relative, 0.0);
        // Inside the body the distance is no lower bound.
        self.distance = near.map_or(reach, |near| near.signed_distance.max(0.0));
        self.face = near.map(|near| near.face);
        let near = near?;
        self.outward = near.outward;
        let depth = thickness - near.signed_distance;
        let ClosestPoint { outward, face, barycentric, .. } = near;
        Some(ContactCorrection { depth, outward, face, barycentric })
    }
}

impl ContactCache {
    /// Push of a triangle of the cloth off the body's vertex that is nearest to its far side or most
    /// beyond it, among those around the closest face of its centre: its barycentric coordinates in the
    /// triangle, and the displacement there, metres.
    fn push_off_vertex(
        &self,
        (body, movement): (&SurfaceIndex, &BodyMovement),
        [a, b, c]: [DVec3; 3],
        thickness: f64,
    ) -> Option<FacePush> {
        // Far centres have searched the whole body and found no face.
        let face = self.face?;
        let cross = (b - a).cross(c - a);
        let normal = cross.try_normalize()?;
        let outward = normal * normal.dot(self.outward).signum();
        // A face that stands on the body has no side that it belongs to.
        if outward.dot(self.outward) < 0.5 {
            return None;
        }
        let mut most = (0.0, [0.0; 3]);
        for &v in &movement.corners_around[face as usize] {
            let p = body.surface().vertices[v as usize];
            let depth = thickness - (a - p).dot(outward);
            if depth <= most.0 || depth > Contact::REACH {
                continue;
            }
            let area = cross.length_squared();
            let share = |from: DVec3, to: DVec3| (to - from).cross(p - from).dot(cross) / area;
            let shares = [share(b, c), share(c, a), share(a, b)];
            if shares.iter().all(|&share| share > 0.0) {
                most = (depth, shares);
            }
        }
        (most.0 > 0.0).then_some((most.1, outward * most.0))
    }
}

/// Closest point of a face and its neighbours: its distance, metres, face, barycentric coordinates,
/// and the way from it to the point.
fn closest_around(
    (body, movement): (&SurfaceIndex, &BodyMovement),
    x: DVec3,
    face: u32,
) -> (f64, u32, [f64; 3], DVec3) {
    let measure = |face: u32| {
        let (nearest, barycentric) = closest_on_triangle(x, body.surface().corners(face as usize));
        let away = x - nearest;
        (away.length(), face, barycentric, away)
    };
    let mut best = measure(face);
    for &other in movement.around[face as usize].iter().filter(|&&other| other != face) {
        let (centre, radius) = movement.spheres[other as usize];
        let least = best.0 + radius;
        if centre.distance_squared(x) < least * least {
            let found = measure(other);
            if found.0 < best.0 {
                best = found;
            }
        }
    }
    best
}
