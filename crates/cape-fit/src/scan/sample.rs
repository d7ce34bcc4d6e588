//! Samples of surfaces.

use glam::DVec3;
use rand::{RngExt, rngs::ChaCha8Rng, seq::SliceRandom};

use super::Scan;

/// A point, metres, with its unit normal, zero if unknown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SurfaceSample {
    pub(crate) at: DVec3,
    pub(crate) normal: DVec3,
}

/// Extents of points along the axes, metres, without the share `share` of outliers at each end.
pub(crate) fn spread(points: &[DVec3], share: f64) -> DVec3 {
    let extent = |axis: usize| {
        let mut values: Vec<f64> = points.iter().map(|point| point[axis]).collect();
        let cut = (share * values.len() as f64) as usize;
        values.sort_unstable_by(f64::total_cmp);
        match (values.get(cut), values.get(values.len().saturating_sub(1 + cut))) {
            (Some(low), Some(high)) => high - low,
            _ => 0.0,
        }
    };
    DVec3::new(extent(0), extent(1), extent(2))
}

/// Samples of a scan in random order: `count` points uniform over its triangles, or at most `count`
/// of its points.
pub(crate) fn sample_scan(scan: &Scan, count: usize, rng: &mut ChaCha8Rng) -> Vec<SurfaceSample> {
    if let Some(samples) = sample_faces(scan.points(), scan.faces(), count, rng) {
        return samples;
    }
    let mut order: Vec<usize> = (0..scan.points().len()).collect();
    order.shuffle(rng);
    let normal = |at: usize| scan.normals().map_or(DVec3::ZERO, |normals| normals[at]);
    let sample = |at: usize| SurfaceSample { at: scan.points()[at], normal: normal(at) };
    order.into_iter().take(count).map(sample).collect()
}

/// `count` random points uniform over the area of triangles; `None` if they have no area.
pub(crate) fn sample_faces(
    vertices: &[DVec3],
    faces: &[[u32; 3]],
    count: usize,
    rng: &mut ChaCha8Rng,
) -> Option<Vec<SurfaceSample>> {
    let mut area = 0.0;
    let areas: Vec<f64> = faces
        .iter()
        .map(|face| {
            area += across(vertices, *face).length();
            area
        })
        .collect();
    if !(area > 0.0 && area.is_finite()) {
        return None;
    }
    let sample = |_| {
        let wanted = rng.random::<f64>() * area;
        let face = faces[areas.partition_point(|&sum| sum <= wanted).min(faces.len() - 1)];
        let [a, b, c] = face.map(|corner| vertices[corner as usize]);
        let (mut u, mut v): (f64, f64) = (rng.random(), rng.random());
        if u + v > 1.0 {
            (u, v) = (1.0 - u, 1.0 - v);
        }
        let normal = across(vertices, face).normalize_or_zero();
        SurfaceSample { at: a + (b - a) * u + (c - a) * v, normal }
    };
    Some((0..count).map(sample).collect())
}

/// Normal of a face with twice its area as length.
fn across(vertices: &[DVec3], face: [u32; 3]) -> DVec3 {
    let [a, b, c] = face.map(|corner| vertices[corner as usize]);
    (b - a).cross(c - a)
}

/// Unit normals of vertices, `[V]`, and the share of the surface area of each, `[V]`.
pub(crate) fn vertex_frames(vertices: &[DVec3], faces: &[[u32; 3]]) -> (Vec<DVec3>, Vec<f64>) {
    let mut normals = vec![DVec3::ZERO; vertices.len()];
    let mut shares = vec![0.0f64; vertices.len()];
    let mut area: f64 = 0.0;
    for &face in faces {
        let normal = across(vertices, face);
        let size = normal.length();
        area += 3.0 * size;
        for corner in face {
            normals[corner as usize] += normal;
            shares[corner as usize] += size;
        }
    }
    let normals = normals.into_iter().map(DVec3::normalize_or_zero).collect();
    let shares = shares.into_iter().map(|share| share / area.max(f64::MIN_POSITIVE)).collect();
    (normals, shares)
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    #[test]
    fn points_lie_evenly_on_the_surface() {
        // A square of side 2 of one large triangle and two small ones, and an empty one.
        let vertices = [[0., 0.], [2., 0.], [2., 2.], [0., 2.], [1., 1.]];
        let vertices = vertices.map(|[x, y]| DVec3::new(x, y, 1.0));
        let faces = [[0, 1, 2], [2, 2, 2], [2, 3, 4], [4, 3, 0]];
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let samples = sample_faces(&vertices, &faces, 4000, &mut rng).unwrap();
        let quarter = samples.iter().filter(|s| s.at.x < 1.0 && s.at.y < 1.0).count();
        assert!((900..1100).contains(&quarter), "{quarter}");
        assert!(samples.iter().all(|s| s.normal == DVec3::Z && (s.at.z - 1.0).abs() < 1e-12));
        assert!(sample_faces(&vertices, &faces[1..2], 10, &mut rng).is_none());
        let (normals, shares) = vertex_frames(&vertices, &faces);
        assert!(normals.iter().all(|normal| *normal == DVec3::Z));
        assert!((shares.iter().sum::<f64>() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn the_spread_leaves_strays_out() {
        let mut points: Vec<DVec3> = (0..100).map(|i| DVec3::X * f64::from(i)).collect();
        points.push(DVec3::splat(1e6));
        let found = spread(&points, 0.02);
        assert!(found.x < 100.0 && found.y == 0.0, "{found}");
        assert_eq!(spread(&[], 0.0), DVec3::ZERO);
    }
}
