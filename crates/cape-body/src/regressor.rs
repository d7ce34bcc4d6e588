//! Joint regressor: signed weights of vertices that give the joints for all shapes.

use glam::DVec3;
use nalgebra::{DMatrix, DVector};

use crate::{Error, Result, cavity::directions};

/// Directions from the joint in each of which the nearest vertices are candidates.
const DIRECTIONS: usize = 128;
/// Candidates in each direction.
const NEAREST: usize = 10;
/// Largest distance of a candidate from the joint, metres.
const REACH: f64 = 0.5;
/// Ridge on the weights: the variance of an error of the vertices to which they are made insensitive,
/// metres².
const RIDGE: f64 = 1e-8;

/// Row of a regressor: (vertex, weight).
pub(crate) type Row = Vec<(u32, f64)>;

/// Weights w of vertices around the joint, of sum 1, that minimise the mean squared distance of `Σ w v`
/// from the joint over `shapes`, with a ridge. Each shape has the vertices of the whole body and the
/// joint; the first is the mean. With `mirror`, the weights of mirrored vertices are equal.
///
/// Weights are of both signs: of positive ones the best are off by centimetres at extreme shapes, as joints
/// do not move as a mean of the skin around them.
pub(crate) fn regress(
    shapes: &[Vec<DVec3>],
    joints: &[DVec3],
    mirror: Option<&dyn Fn(u32) -> u32>,
) -> Result<Row> {
    let candidates = around(&shapes[0], joints[0]);
    let n = candidates.len();
    let scale = 1.0 / (shapes.len() as f64).sqrt();
    let offsets = DMatrix::from_fn(3 * shapes.len(), n, |row, column| {
        let shape = row / 3;
        (shapes[shape][candidates[column] as usize] - joints[shape])[row % 3] * scale
    });
    // With a sum of 1 the offsets from the joint sum to 0: w is along (G + ridge)⁻¹ 1.
    let gram = offsets.tr_mul(&offsets) + DMatrix::from_diagonal_element(n, n, RIDGE);
    let weights = gram
        .cholesky()
        .ok_or_else(|| Error::argument("joint regressor: no vertices around a joint"))?
        .solve(&DVector::from_element(n, 1.0));
    let mut row: Row = candidates.into_iter().zip(weights.iter().copied()).collect();
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
    Ok(row)
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
        let row = regress(&shapes, &shifts, None).unwrap();
        assert!((row.iter().map(|r| r.1).sum::<f64>() - 1.0).abs() < 1e-12);
        for (shape, centre) in shapes.iter().zip(shifts) {
            let found: DVec3 = row.iter().map(|&(v, w)| shape[v as usize] * w).sum();
            assert!(found.distance(centre) < 1e-4, "{found} {centre}");
        }
    }
}
