use rayon::prelude::*;

use crate::{
    Error, Result,
    geometry::{Solid, Surface},
};

/// A clothing vertex and the body vertex whose ray found it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pair {
    /// The clothing vertex.
    pub clothing: u32,
    /// The body vertex.
    pub body: u32,
    /// Length of the ray, metres.
    pub distance: f64,
}

/// What the rays met; tells flipped normals and misplaced meshes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RayStatistics {
    /// Rays cast: one for each body vertex that has a normal.
    pub rays: usize,
    /// Rays that met the clothing.
    pub hits: usize,
    /// Hits on the clothing's outer side, which faces away from the body only if the clothing's
    /// faces are flipped.
    pub on_outer_side: usize,
    /// Rays that would have met the clothing in the opposite direction, into the body.
    pub behind: usize,
    /// Clothing vertices inside the body.
    pub inside: usize,
}

impl RayStatistics {
    /// Whether most rays met the clothing from its outer side: its faces look towards the body.
    pub fn clothing_is_flipped(&self) -> bool {
        2 * self.on_outer_side > self.hits
    }
}

/// What one ray met: the pair and whether it came from the clothing's outer side; and whether the
/// opposite ray met anything.
type Ray = (Option<(Pair, bool)>, bool);

/// Sparse correspondences of one frame, at most one for each clothing vertex.
#[derive(Debug, Clone, PartialEq)]
pub struct Pairs {
    /// By ascending clothing vertex.
    pub pairs: Vec<Pair>,
    /// What the rays met.
    pub statistics: RayStatistics,
}

impl Pairs {
    /// Casts a ray of `reach` metres along the outward normal of every body vertex; where it first
    /// meets the clothing, the closest corner of the face it meets is the body vertex's. Of several
    /// body vertices that claim one clothing vertex, the one with the shortest ray keeps it; of
    /// equal ones, the first.
    pub fn find(body: &Surface, clothing: &Surface, reach: f64) -> Result<Self> {
        let solid = Solid::new(clothing);
        let sides = clothing.face_normals();
        let normals = body.vertex_normals();
        let seen: Vec<Option<Ray>> = (0..body.vertices.len())
            .into_par_iter()
            .map(|vertex| {
                let (origin, normal) = (body.vertices[vertex], normals[vertex]);
                if normal.length_squared() == 0.0 {
                    return None;
                }
                let hit = solid.cast(origin, normal, reach).map(|hit| {
                    let corners = clothing.faces[hit.face as usize];
                    let far = |v: u32| clothing.vertices[v as usize].distance(hit.point);
                    let [a, b, c] = corners;
                    let closest = [b, c]
                        .into_iter()
                        .fold(a, |best, v| if far(v) < far(best) { v } else { best });
                    let outer = sides[hit.face as usize].dot(normal) < 0.0;
                    let body = vertex as u32;
                    (Pair { clothing: closest, body, distance: hit.distance }, outer)
                });
                Some((hit, solid.cast(origin, -normal, reach).is_some()))
            })
            .collect();
        let inside = inside(body, clothing);
        let mut statistics = RayStatistics { inside, ..RayStatistics::default() };
        let mut kept: Vec<Option<Pair>> = vec![None; clothing.vertices.len()];
        for (hit, behind) in seen.into_iter().flatten() {
            statistics.rays += 1;
            statistics.behind += usize::from(behind);
            let Some((pair, outer)) = hit else { continue };
            statistics.hits += 1;
            statistics.on_outer_side += usize::from(outer);
            let place = &mut kept[pair.clothing as usize];
            if place.is_none_or(|held| pair.distance < held.distance) {
                *place = Some(pair);
            }
        }
        let RayStatistics { rays, hits, behind, .. } = statistics;
        if hits == 0 && behind == 0 {
            return Err(Error::NoHits { rays, reach });
        }
        if behind > hits {
            return Err(Error::FlippedBody { ahead: hits, behind });
        }
        Ok(Self { pairs: kept.into_iter().flatten().collect(), statistics })
    }
}

/// Clothing vertices inside the body.
fn inside(body: &Surface, clothing: &Surface) -> usize {
    let solid = Solid::new(body);
    let within = |p| solid.closest(p, f64::INFINITY).is_some_and(|c| c.signed_distance < 0.0);
    clothing.vertices.par_iter().filter(|&&p| within(p)).count()
}
