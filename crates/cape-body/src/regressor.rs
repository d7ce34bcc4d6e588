//! Joint regressor: non-negative weights that give the joints for all shapes.

use glam::DVec3;

use crate::cavity::directions;

/// Directions from the joint in each of which the nearest vertices are candidates.
const DIRECTIONS: usize = 64;
/// Candidates in each direction.
const NEAREST: usize = 5;
/// Largest distance of a candidate from the joint, metres.
const REACH: f64 = 0.4;
/// Sweeps of coordinate descent.
const SWEEPS: usize = 6000;
/// Weight of the condition that weights sum to 1, metres.
const SUM: f64 = 0.3;
/// Ridge on the weights, metres².
const RIDGE: f64 = 1e-8;

/// Row of a regressor: (vertex, weight).
pub(crate) type Row = Vec<(u32, f64)>;

/// Weights w ≥ 0 of vertices around the joint that minimise the squared distance of `Σ w v` from the joint,
/// summed over `shapes`, by coordinate descent. Each shape has the vertices of the whole body and the
/// joint; the first is the mean. With `mirror`, the weights of mirrored vertices are equal.
pub(crate) fn regress(
    shapes: &[Vec<DVec3>],
    joints: &[DVec3],
    mirror: Option<&dyn Fn(u32) -> u32>,
) -> Row {
    let candidates = around(&shapes[0], joints[0]);
    let n = candidates.len();
    let mut gram = vec![SUM * SUM; n * n];
    let scale = 1.0 / shapes.len() as f64;
    for (vertices, &joint) in shapes.iter().zip(joints) {
        let offsets: Vec<DVec3> =
            candidates.iter().map(|&v| vertices[v as usize] - joint).collect();
        for (row, a) in gram.chunks_exact_mut(n).zip(&offsets) {
            row.iter_mut().zip(&offsets).for_each(|(sum, b)| *sum += a.dot(*b) * scale);
        }
    }
    for i in 0..n {
        gram[i * n + i] += RIDGE;
    }
    let mut weights = vec![1.0 / n as f64; n];
    for _ in 0..SWEEPS {
        for (i, row) in gram.chunks_exact(n).enumerate() {
            let product: f64 = row.iter().zip(&weights).map(|(g, w)| g * w).sum();
            weights[i] = (weights[i] + (SUM * SUM - product) / row[i]).max(0.0);
        }
    }
    let mut row: Row = candidates.into_iter().zip(weights).filter(|&(_, w)| w > 1e-4).collect();
    if let Some(mirror) = mirror {
        let mirrored: Row = row.iter().map(|&(v, w)| (mirror(v), w)).collect();
        row.extend(mirrored);
    }
    row.sort_by_key(|&(v, _)| v);
    row.dedup_by(|next, kept| {
        let same = next.0 == kept.0;
        if same {
            kept.1 += next.1;
        }
        same
    });
    let sum: f64 = row.iter().map(|&(_, w)| w).sum();
    for (_, w) in &mut row {
        *w /= sum;
    }
    row
}

/// Vertices nearest to the joint in each direction.
fn around(vertices: &[DVec3], joint: DVec3) -> Vec<u32> {
    let axes: Vec<DVec3> = directions(DIRECTIONS).collect();
    let mut cells: Vec<Vec<(f64, u32)>> = vec![Vec::new(); axes.len()];
    for (v, &p) in vertices.iter().enumerate() {
        let (offset, distance) = (p - joint, p.distance(joint));
        let nearest = (0..axes.len())
            .max_by(|&a, &b| axes[a].dot(offset).total_cmp(&axes[b].dot(offset)).then(b.cmp(&a)));
        if let Some(cell) = nearest.filter(|_| distance < REACH) {
            cells[cell].push((distance, v as u32));
        }
    }
    let mut found = Vec::new();
    for mut cell in cells {
        cell.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        found.extend(cell.into_iter().take(NEAREST).map(|(_, v)| v));
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The centre of stretched and shifted spheres.
    #[test]
    fn the_centre_of_ellipsoids_is_found() {
        let sphere: Vec<DVec3> = directions(500).map(|p| p * 0.1).collect();
        let moved =
            |scale: DVec3, shift: DVec3| sphere.iter().map(|&p| p * scale + shift).collect();
        let shifts = [DVec3::ZERO, DVec3::new(0.3, 0.0, 0.1), DVec3::new(-0.1, 0.2, 0.0)];
        let scales = [DVec3::ONE, DVec3::new(2.0, 1.0, 0.7), DVec3::new(0.5, 1.5, 1.0)];
        let shapes: Vec<Vec<DVec3>> =
            shifts.iter().zip(scales).map(|(&shift, scale)| moved(scale, shift)).collect();
        let row = regress(&shapes, &shifts, None);
        assert!((row.iter().map(|r| r.1).sum::<f64>() - 1.0).abs() < 1e-12);
        assert!(row.iter().all(|r| r.1 > 0.0));
        for (shape, centre) in shapes.iter().zip(shifts) {
            let found: DVec3 = row.iter().map(|&(v, w)| shape[v as usize] * w).sum();
            assert!(found.distance(centre) < 1e-4, "{found} {centre}");
        }
    }
}
