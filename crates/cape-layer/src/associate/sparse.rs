use rayon::prelude::*;

use crate::{Error, Result};
use cape_core::geometry::{SurfaceIndex, SurfaceMesh};

/// A clothing vertex and the body vertex whose ray hit it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Correspondence {
    /// Index of the clothing vertex.
    pub clothing: u32,
    /// Index of the body vertex.
    pub body: u32,
    /// Length of the ray, metres.
    pub distance: f64,
}

/// Counts of ray hits, which reveal reversed normals and misplaced meshes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RayStatistics {
    /// Rays: one for each body vertex that has a normal.
    pub rays: usize,
    /// Rays that hit the clothing.
    pub hits: usize,
    /// Hits on the outer side of the clothing: a hand beside a skirt, or all hits if the clothing's
    /// faces are reversed.
    pub on_outer_side: usize,
    /// Hits behind another part of the body, such as through the other leg of a skirt.
    pub blocked: usize,
    /// Rays that hit the clothing in the opposite direction, into the body.
    pub behind: usize,
    /// Clothing vertices inside the body.
    pub inside: usize,
}

impl RayStatistics {
    /// True if most rays hit the outer side of the clothing: its faces point towards the body.
    pub fn clothing_is_flipped(&self) -> bool {
        2 * self.on_outer_side > self.hits
    }
}

/// Distance from its vertex at which the ray that tests for occlusion by the body starts, metres.
const OFF_THE_SKIN: f64 = 1e-3;

/// A pair that a ray found, with the reasons to reject it.
#[derive(Debug, Clone, Copy)]
struct RayPair {
    pair: Correspondence,
    on_outer_side: bool,
    blocked: bool,
}

/// Sparse correspondences of one frame, at most one for each clothing vertex.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use cape_layer::associate::SparseCorrespondences;
///
/// let found = SparseCorrespondences::find(&octahedron(0.1), &octahedron(0.12), 0.15)?;
/// assert_eq!((found.statistics.rays, found.pairs.len()), (6, 6));
/// for pair in &found.pairs {
///     assert_eq!(pair.body, pair.clothing);
///     assert!((pair.distance - 0.02).abs() < 1e-6);
/// }
/// assert!(!found.statistics.clothing_is_flipped());
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct SparseCorrespondences {
    /// Pairs in ascending order of their clothing vertex.
    pub pairs: Vec<Correspondence>,
    /// Counts of ray hits.
    pub statistics: RayStatistics,
}

impl SparseCorrespondences {
    /// Casts a ray of `reach` metres along the outward normal of every body vertex and pairs the
    /// vertex with the closest corner of the first clothing face that the ray hits. Rays that hit
    /// the minority side of the clothing (a hand beside a skirt) and rays that another part of the
    /// body blocks are rejected. Each clothing vertex keeps the pair with the shortest ray, the
    /// lowest body vertex among equal ones.
    ///
    /// # Errors
    /// If no ray hits the clothing, or more do against the normals than along them.
    pub fn find(body: &SurfaceMesh, clothing: &SurfaceMesh, reach: f64) -> Result<Self> {
        let (solid, flesh) = (SurfaceIndex::new(clothing), SurfaceIndex::new(body));
        let sides = clothing.face_normals();
        let normals = body.vertex_normals();
        let seen: Vec<Option<(Option<RayPair>, bool)>> = (0..body.vertices.len())
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
                    let start = OFF_THE_SKIN.min(0.5 * hit.distance);
                    let way = hit.distance - start;
                    let pair = Correspondence {
                        clothing: closest,
                        body: vertex as u32,
                        distance: hit.distance,
                    };
                    RayPair {
                        pair,
                        on_outer_side: sides[hit.face as usize].dot(normal) < 0.0,
                        blocked: flesh.cast(origin + normal * start, normal, way).is_some(),
                    }
                });
                Some((hit, solid.cast(origin, -normal, reach).is_some()))
            })
            .collect();
        let mut statistics =
            RayStatistics { inside: inside(&flesh, clothing), ..RayStatistics::default() };
        for (met, behind) in seen.iter().flatten() {
            statistics.rays += 1;
            statistics.behind += usize::from(*behind);
            if let Some(met) = met {
                statistics.hits += 1;
                statistics.on_outer_side += usize::from(met.on_outer_side);
                statistics.blocked += usize::from(met.blocked);
            }
        }
        let majority = statistics.clothing_is_flipped();
        let mut kept: Vec<Option<Correspondence>> = vec![None; clothing.vertices.len()];
        for RayPair { pair, on_outer_side, blocked } in
            seen.into_iter().flatten().filter_map(|(met, _)| met)
        {
            let place = &mut kept[pair.clothing as usize];
            if on_outer_side == majority
                && !blocked
                && place.is_none_or(|held| pair.distance < held.distance)
            {
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
        let pairs: Vec<Correspondence> = kept.into_iter().flatten().collect();
        if pairs.is_empty() {
            return Err(Error::NoHits { rays, reach });
        }
        Ok(Self { pairs, statistics })
    }
}

/// Number of clothing vertices inside the body.
fn inside(body: &SurfaceIndex, clothing: &SurfaceMesh) -> usize {
    let within = |p| body.closest(p, f64::INFINITY).is_some_and(|near| near.signed_distance < 0.0);
    clothing.vertices.par_iter().filter(|&&p| within(p)).count()
}
