use std::collections::HashMap;

use glam::{DVec3, IVec3};
use rayon::prelude::*;

use crate::geometry::Solid;

/// Contact of cloth vertices with a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// Coefficient of Coulomb friction.
    pub friction: f64,
    /// Distance kept, metres.
    pub thickness: f64,
    /// Where the body was on its way a step ago, 0 to 1.
    pub from: f64,
    /// Where it is now.
    pub now: f64,
}

impl Contact {
    /// How deep inside the body a vertex may be and still be brought out, metres.
    pub const REACH: f64 = 0.05;

    /// Moves every vertex that is closer than the thickness, or inside, out along the direction of
    /// growing distance, and holds back its movement relative to the body under it by at most the
    /// friction times that way. `before` are the positions a step ago.
    pub fn resolve(
        &self,
        body: &Solid,
        before: &[DVec3],
        positions: &mut [DVec3],
        inverse_masses: &[f64],
    ) {
        let moving = positions.par_iter_mut().zip(before).zip(inverse_masses);
        moving.filter(|&(_, &w)| w > 0.0).for_each(|((x, &before), _)| {
            let Some(near) = body.closest(*x, Self::REACH) else { return };
            let depth = self.thickness - near.signed_distance;
            if depth <= 0.0 {
                return;
            }
            *x += near.outward * depth;
            let carried = body.riding(near.face, near.barycentric, self.now)
                - body.riding(near.face, near.barycentric, self.from);
            let slip = (*x - before) - carried;
            let slip = slip - near.outward * slip.dot(near.outward);
            let length = slip.length();
            if length > 0.0 {
                *x -= slip * (self.friction * depth / length).min(1.0);
            }
        });
    }
}

/// Vertices by the cell of a grid that they are in.
pub(super) struct SpatialHash {
    size: f64,
    cells: HashMap<IVec3, Vec<u32>>,
}

impl SpatialHash {
    /// Cells of `size` metres. Every vertex is listed in the cells around its own as well, so that
    /// one look finds all within `size`, in ascending order.
    pub(super) fn new(positions: &[DVec3], size: f64) -> Self {
        let mut hash = Self { size, cells: HashMap::with_capacity(positions.len() * 8) };
        for (vertex, &p) in positions.iter().enumerate() {
            let cell = hash.cell(p);
            for x in -1..=1 {
                for y in -1..=1 {
                    for z in -1..=1 {
                        let near = cell + IVec3::new(x, y, z);
                        hash.cells.entry(near).or_default().push(vertex as u32);
                    }
                }
            }
        }
        hash
    }

    /// Vertices that may be within a cell's size of `p`.
    pub(super) fn near(&self, p: DVec3) -> &[u32] {
        self.cells.get(&self.cell(p)).map_or(&[], Vec::as_slice)
    }

    fn cell(&self, p: DVec3) -> IVec3 {
        (p / self.size).floor().as_ivec3()
    }
}
