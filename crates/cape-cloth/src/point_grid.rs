use cape_core::geometry::bounds;
use glam::{DVec3, IVec3};

/// Most cells along an axis; the cells of larger clouds are larger.
const MOST: f64 = 128.0;

/// Points sorted into the cells of a regular grid, for searches of points near one.
#[derive(Debug, Clone, Default)]
pub(super) struct PointGrid {
    low: DVec3,
    cell: f64,
    counts: IVec3,
    /// First point of each cell, and the number of points.
    starts: Vec<u32>,
    /// Points by cell, in ascending order within one, and their indices.
    points: Vec<(DVec3, u32)>,
}

impl PointGrid {
    /// A grid with cells of `cell` metres.
    pub(super) fn new(points: &[DVec3], cell: f64) -> Self {
        if points.is_empty() {
            return Self::default();
        }
        let [low, high] = bounds(points.iter().copied());
        let cell = cell.max((high - low).max_element() / MOST).max(f64::MIN_POSITIVE);
        let counts = ((high - low) / cell).floor().as_ivec3() + IVec3::ONE;
        let cells = (counts.x * counts.y * counts.z) as usize;
        let mut grid = Self { low, cell, counts, starts: vec![0; cells + 1], points: Vec::new() };
        let places: Vec<usize> = points.iter().map(|&p| grid.place(grid.cell_of(p))).collect();
        for &place in &places {
            grid.starts[place + 1] += 1;
        }
        for place in 0..cells {
            grid.starts[place + 1] += grid.starts[place];
        }
        let mut next = grid.starts.clone();
        grid.points = vec![(DVec3::ZERO, 0); points.len()];
        for ((index, &point), place) in points.iter().enumerate().zip(places) {
            grid.points[next[place] as usize] = (point, index as u32);
            next[place] += 1;
        }
        grid
    }

    /// Calls `visit` with the index and the squared distance, m², of each point within `reach` metres of
    /// `from`, in an order that does not depend on threads.
    pub(super) fn for_near(&self, from: DVec3, reach: f64, mut visit: impl FnMut(u32, f64)) {
        if self.points.is_empty() {
            return;
        }
        let last = self.counts - IVec3::ONE;
        let [low, high] = [-1.0, 1.0]
            .map(|way| self.cell_of(from + DVec3::splat(way * reach)).clamp(IVec3::ZERO, last));
        for z in low.z..=high.z {
            for y in low.y..=high.y {
                // Cells along x follow one another.
                let [first, end] = [low.x, high.x + 1].map(|x| {
                    self.starts[self.place(IVec3::new(low.x, y, z)) + (x - low.x) as usize]
                });
                for &(point, index) in &self.points[first as usize..end as usize] {
                    let distance = point.distance_squared(from);
                    if distance <= reach * reach {
                        visit(index, distance);
                    }
                }
            }
        }
    }

    fn cell_of(&self, point: DVec3) -> IVec3 {
        ((point - self.low) / self.cell).floor().as_ivec3()
    }

    fn place(&self, cell: IVec3) -> usize {
        ((cell.z * self.counts.y + cell.y) * self.counts.x + cell.x) as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn near_points_are_those_of_brute_force() {
        let at = |k: u32| {
            let k = f64::from(k);
            DVec3::new((k * 1.3).sin(), 0.1 * (k * 2.1).cos(), 3.0 * (k * 0.7).sin())
        };
        let points: Vec<DVec3> = (0..500).map(at).collect();
        for (reach, grid) in [0.05, 0.4, 10.0].map(|reach| (reach, PointGrid::new(&points, reach)))
        {
            for k in 0..600 {
                let from = 1.1 * at(2 * k + 1);
                let mut found = Vec::new();
                grid.for_near(from, reach, |index, distance| {
                    assert_eq!(distance, points[index as usize].distance_squared(from));
                    found.push(index);
                });
                found.sort_unstable();
                let near = |&k: &u32| points[k as usize].distance(from) <= reach;
                assert_eq!(found, (0..500).filter(near).collect::<Vec<u32>>());
            }
        }
        PointGrid::new(&[], 1.0).for_near(DVec3::ZERO, 1.0, |_, _| unreachable!());
    }
}
