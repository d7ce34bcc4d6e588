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

/// Vertices by the cell of an unbounded grid, in a table of as many places (Teschner et al. 2003).
pub(super) struct SpatialHash {
    size: f64,
    /// Where each place's vertices start, and the end of the last, `[places + 1]`.
    starts: Vec<u32>,
    /// Vertices by place, ascending in each.
    vertices: Vec<u32>,
}

impl SpatialHash {
    /// Cells of `size` metres.
    pub(super) fn new(positions: &[DVec3], size: f64) -> Self {
        let places = (2 * positions.len()).max(1);
        let mut hash =
            Self { size, starts: vec![0; places + 1], vertices: vec![0; positions.len()] };
        let at: Vec<usize> = positions.iter().map(|&p| hash.place(hash.cell(p))).collect();
        for &place in &at {
            hash.starts[place + 1] += 1;
        }
        for place in 0..places {
            hash.starts[place + 1] += hash.starts[place];
        }
        let mut next = hash.starts.clone();
        for (vertex, place) in at.into_iter().enumerate() {
            hash.vertices[next[place] as usize] = vertex as u32;
            next[place] += 1;
        }
        hash
    }

    /// All vertices within a cell's size of `p`, and others; some more than once.
    pub(super) fn near(&self, p: DVec3) -> impl Iterator<Item = u32> + '_ {
        let cell = self.cell(p);
        (0..27).flat_map(move |k| {
            let place = self.place(cell + IVec3::new(k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1));
            let (from, to) = (self.starts[place] as usize, self.starts[place + 1] as usize);
            self.vertices[from..to].iter().copied()
        })
    }

    fn cell(&self, p: DVec3) -> IVec3 {
        (p / self.size).floor().as_ivec3()
    }

    fn place(&self, cell: IVec3) -> usize {
        let mixed = cell.x.wrapping_mul(73_856_093)
            ^ cell.y.wrapping_mul(19_349_663)
            ^ cell.z.wrapping_mul(83_492_791);
        mixed as u32 as usize % (self.starts.len() - 1)
    }
}
