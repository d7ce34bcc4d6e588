use glam::DVec3;
use rayon::prelude::*;

use cape_core::geometry::SurfaceIndex;

/// Contact of cloth with a body, at vertices and at the middles of faces.
///
/// ```
/// use cape_cloth::{Contact, ClothMaterial};
///
/// // What cloth of a material keeps to, half a step on the way.
/// let ClothMaterial { friction, thickness, .. } = ClothMaterial::default();
/// let contact = Contact { friction, thickness, from: 0.0, now: 0.5 };
/// assert!(contact.thickness < Contact::REACH);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// Coefficient of Coulomb friction.
    pub friction: f64,
    /// Distance that vertices keep, metres; middles of faces keep half of it.
    pub thickness: f64,
    /// Where the body was on its way a step ago, 0 to 1.
    pub from: f64,
    /// Where it is now.
    pub now: f64,
}

impl Contact {
    /// How deep inside the body a vertex may be and still be brought out, metres. Deeper ones are
    /// between limbs that meet; their neighbours bring them out, on the side that they came from.
    pub const REACH: f64 = 0.02;
}

/// What a point of the cloth remembers of the body, so that most steps need not look for it.
#[derive(Debug, Clone, Copy, Default)]
struct ContactCache {
    face: Option<u32>,
    /// The body was no closer than this, metres,
    distance: f64,
    /// when the point was here,
    at: DVec3,
    /// and the body's vertices had gone no further than this, metres.
    travelled: f64,
}

/// How far outside or inside a point is to be pushed, and where the body is there.
#[derive(Debug, Clone, Copy)]
struct ContactCorrection {
    depth: f64,
    outward: DVec3,
    face: u32,
    barycentric: [f64; 3],
}

/// Contacts of one piece of cloth over time.
#[derive(Debug, Clone, Default)]
pub(super) struct Contacts {
    vertices: Vec<ContactCache>,
    middles: Vec<ContactCache>,
    /// Longest way of any vertex of the body so far, metres.
    travelled: f64,
}

impl Contacts {
    pub(super) fn new(vertices: usize, faces: usize) -> Self {
        Self {
            vertices: vec![ContactCache::default(); vertices],
            middles: vec![ContactCache::default(); faces],
            travelled: 0.0,
        }
    }

    /// Moves faces whose middle, then vertices that are closer than the thickness, or inside, out
    /// along the direction of growing distance, and holds back the vertices' movement relative to
    /// the body under them by at most the friction times that way. `before` are the positions a
    /// step ago.
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

    /// Each vertex goes the mean way that the faces around it that are too deep ask for.
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
            .zip(&mut self.middles)
            .map(|(corners, memory)| {
                let middle = corners.iter().map(|&v| at[v as usize]).sum::<DVec3>() / 3.0;
                let push = memory.push(body, middle, 0.5 * contact.thickness, travelled)?;
                Some(push.outward * push.depth)
            })
            .collect();
        let mut ways = vec![(DVec3::ZERO, 0.0); positions.len()];
        for (corners, push) in faces.iter().zip(pushes) {
            let Some(push) = push else { continue };
            // Δx = w_i ∇_i λ with gradients of 1/3 each.
            let weights = corners.map(|v| inverse_masses[v as usize]);
            let sum: f64 = weights.iter().sum();
            for (&v, w) in corners.iter().zip(weights).filter(|_| sum > 0.0) {
                let (way, count) = &mut ways[v as usize];
                *way += push * (3.0 * w / sum);
                *count += 1.0;
            }
        }
        for (x, (way, count)) in positions.iter_mut().zip(ways).filter(|(_, way)| way.1 > 0.0) {
            *x += way / count;
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
        // Inside it could be anywhere in the next step.
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
