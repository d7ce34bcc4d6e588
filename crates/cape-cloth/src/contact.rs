use glam::DVec3;
use rayon::prelude::*;

use cape_core::geometry::SurfaceIndex;

/// Parameters of the contact of cloth with a body in one step, at vertices and at the centres of
/// faces.
///
/// ```
/// use cape_cloth::{Contact, ClothMaterial};
///
/// // Contact of the default material in the first half of a frame.
/// let ClothMaterial { friction, thickness, .. } = ClothMaterial::default();
/// let contact = Contact { friction, thickness, from: 0.0, now: 0.5 };
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
}

impl Contact {
    /// Greatest depth inside the body from which a vertex is pushed out, metres. Deeper vertices are
    /// between limbs that touch; their neighbours pull them out on the side that they came from.
    pub const REACH: f64 = 0.02;
}

/// Last closest point on the body of a point of the cloth, by which most steps skip the query.
#[derive(Debug, Clone, Copy, Default)]
struct ContactCache {
    face: Option<u32>,
    /// Lower bound of the distance from the body at the last query, metres.
    distance: f64,
    /// Position of the point at the last query, metres.
    at: DVec3,
    /// Largest path length of the body's vertices at the last query, metres.
    travelled: f64,
}

/// Displacement that resolves a contact: `outward` times `depth`, metres, and the point of the body.
#[derive(Debug, Clone, Copy)]
struct ContactCorrection {
    depth: f64,
    outward: DVec3,
    face: u32,
    barycentric: [f64; 3],
}

/// Contact caches of a piece of cloth.
#[derive(Debug, Clone, Default)]
pub(super) struct Contacts {
    vertices: Vec<ContactCache>,
    centres: Vec<ContactCache>,
    /// Upper bound of the path length of the body's vertices so far, metres.
    travelled: f64,
}

impl Contacts {
    pub(super) fn new(vertices: usize, faces: usize) -> Self {
        Self {
            vertices: vec![ContactCache::default(); vertices],
            centres: vec![ContactCache::default(); faces],
            travelled: 0.0,
        }
    }

    /// Pushes out faces whose centres, then vertices that are closer to the body than the thickness
    /// allows, along the gradient of the distance, and applies Coulomb friction: the tangential
    /// movement of a vertex relative to the body is reduced by at most the friction times its push.
    /// `before` are the positions before the step, metres.
    pub(super) fn resolve(
        &mut self,
        contact: &Contact,
        body: &SurfaceIndex,
        before: &[DVec3],
        positions: &mut [DVec3],
        (inverse_masses, faces): (&[f64], &[[u32; 3]]),
    ) {
        self.travelled += body.largest_displacement() * (contact.now - contact.from);
        let travelled = self.travelled;
        self.push_out_faces(contact, body, positions, (inverse_masses, faces));
        let moving = positions.par_iter_mut().zip(before).zip(inverse_masses);
        moving.zip(&mut self.vertices).filter(|((_, w), _)| **w > 0.0).for_each(
            |(((x, &before), _), memory)| {
                let Some(push) = memory.push(body, *x, contact.thickness, travelled) else {
                    return;
                };
                let ContactCorrection { depth, outward, face, barycentric } = push;
                *x += outward * depth;
                let carried = body.position_at(face, barycentric, contact.now)
                    - body.position_at(face, barycentric, contact.from);
                let slip = (*x - before) - carried;
                let slip = slip - outward * slip.dot(outward);
                let length = slip.length();
                if length > 0.0 {
                    *x -= slip * (contact.friction * depth / length).min(1.0);
                }
            },
        );
    }

    /// Moves each vertex by the mean of the pushes of its faces.
    fn push_out_faces(
        &mut self,
        contact: &Contact,
        body: &SurfaceIndex,
        positions: &mut [DVec3],
        (inverse_masses, faces): (&[f64], &[[u32; 3]]),
    ) {
        let (at, travelled) = (&*positions, self.travelled);
        let pushes: Vec<Option<DVec3>> = faces
            .par_iter()
            .zip(&mut self.centres)
            .map(|(corners, memory)| {
                let centre = corners.iter().map(|&v| at[v as usize]).sum::<DVec3>() / 3.0;
                let push = memory.push(body, centre, 0.5 * contact.thickness, travelled)?;
                Some(push.outward * push.depth)
            })
            .collect();
        let mut moves = vec![(DVec3::ZERO, 0.0); positions.len()];
        for (corners, push) in faces.iter().zip(pushes) {
            let Some(push) = push else { continue };
            // Δx = w_i ∇_i λ with gradients of 1/3 each.
            let weights = corners.map(|v| inverse_masses[v as usize]);
            let total: f64 = weights.iter().sum();
            for (&v, w) in corners.iter().zip(weights).filter(|_| total > 0.0) {
                let (sum, count) = &mut moves[v as usize];
                *sum += push * (3.0 * w / total);
                *count += 1.0;
            }
        }
        for (x, (sum, count)) in positions.iter_mut().zip(moves).filter(|(_, all)| all.1 > 0.0) {
            *x += sum / count;
        }
    }
}

impl ContactCache {
    fn push(
        &mut self,
        body: &SurfaceIndex,
        x: DVec3,
        thickness: f64,
        travelled: f64,
    ) -> Option<ContactCorrection> {
        let reach = Contact::REACH.max(thickness);
        if self.distance - x.distance(self.at) - (travelled - self.travelled) > thickness {
            return None;
        }
        let near = body.closest_from(x, reach, self.face);
        (self.at, self.travelled) = (x, travelled);
        // Inside the body the distance is no lower bound.
        self.distance = near.map_or(reach, |near| near.signed_distance.max(0.0));
        self.face = near.map(|near| near.face);
        let near = near?;
        let depth = thickness - near.signed_distance;
        (depth > 0.0).then_some(ContactCorrection {
            depth,
            outward: near.outward,
            face: near.face,
            barycentric: near.barycentric,
        })
    }
}
