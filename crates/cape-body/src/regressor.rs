//! Joint regressor: non-negative weights that give the joints for all shapes.

use glam::DVec3;

/// Vertices nearest to the joint among which weights are sought.
const NEAREST: usize = 160;
/// Sweeps of coordinate descent.
const SWEEPS: usize = 4000;
/// Weight of the condition that weights sum to 1, metres.
const SUM: f64 = 2.0;
/// Ridge on the weights, metres².
const RIDGE: f64 = 1e-8;

/// Row of a regressor: (vertex, weight).
pub(crate) type Row = Vec<(u32, f64)>;

/// Weights w ≥ 0 of the vertices nearest to the joint that minimise the squared distance of `Σ w v`
/// from the joint, summed over the mean shape and the ends of the shape directions, by coordinate
/// descent. Each item of `shapes` holds vertices or displacements of the whole body and of the joint,
/// the mean first. With `mirror`, the weights of mirrored vertices are equal.
pub(crate) fn regress(shapes: &[(Vec<DVec3>, DVec3)], mirror: Option<&dyn Fn(u32) -> u32>) -> Row {
    let (mean, joint) = &shapes[0];
    let mut near: Vec<u32> = (0..mean.len() as u32).collect();
    near.sort_by(|&a, &b| {
        let distance = |v: u32| mean[v as usize].distance_squared(*joint);
        distance(a).total_cmp(&distance(b)).then(a.cmp(&b))
    });
    near.truncate(NEAREST);
    let mut equations: Vec<(Vec<f64>, f64)> = vec![(vec![SUM; near.len()], SUM)];
    for (index, (vertices, joint)) in shapes.iter().enumerate() {
        let origin = if index == 0 { *joint } else { DVec3::ZERO };
        for axis in 0..3 {
            let row = near.iter().map(|&v| (vertices[v as usize] - origin)[axis]).collect();
            equations.push((row, (*joint - origin)[axis]));
        }
    }
    let n = near.len();
    let mut gram = vec![0.0; n * n];
    let mut right = vec![0.0; n];
    for (row, value) in &equations {
        for i in 0..n {
            right[i] += row[i] * value;
            for j in 0..n {
                gram[i * n + j] += row[i] * row[j];
            }
        }
    }
    for i in 0..n {
        gram[i * n + i] += RIDGE;
    }
    let mut weights = vec![1.0 / n as f64; n];
    for _ in 0..SWEEPS {
        for i in 0..n {
            let row = &gram[i * n..(i + 1) * n];
            let residual: f64 =
                right[i] - row.iter().zip(&weights).map(|(g, w)| g * w).sum::<f64>();
            weights[i] = (weights[i] + residual / row[i]).max(0.0);
        }
    }
    let mut row: Row = near.into_iter().zip(weights).filter(|&(_, w)| w > 1e-4).collect();
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
