use crate::{
    Error, Result,
    image::MAX_SIDE,
    raster::{EMPTY, Point, rasterise},
};

/// Largest coordinate that is drawn, pixels.
const MAX_COORDINATE: f64 = 1e6;

/// Index of the visible triangle at the centre of each pixel, `[height · width]`; `None` without one.
///
/// `points` are `[column, row, distance]`, pixels (y down) and distance from the camera; points of
/// distance 0 or less are not drawn. Depth is interpolated in perspective.
///
/// # Errors
/// If the image has no pixels or too many, or a point index is out of range.
pub fn visible_faces(
    points: &[[f64; 3]],
    faces: &[[u32; 3]],
    width: u32,
    height: u32,
) -> Result<Vec<Option<u32>>> {
    if width == 0 || height == 0 || width > MAX_SIDE || height > MAX_SIDE {
        return Err(Error::Argument(format!(
            "image of {width}×{height} pixels: each side must be from 1 to {MAX_SIDE}"
        )));
    }
    if let Some(face) = faces.iter().find(|face| face.iter().any(|&i| i as usize >= points.len())) {
        return Err(Error::Argument(format!(
            "face {face:?} is out of range for {} points",
            points.len()
        )));
    }
    let points: Vec<Point> = points.iter().map(point).collect();
    let seen = rasterise(&points, faces, width as usize, height as usize);
    Ok(seen.face.into_iter().map(|face| (face != EMPTY).then_some(face)).collect())
}

fn point(&[x, y, distance]: &[f64; 3]) -> Point {
    let valid = distance > 0.0
        && distance.is_finite()
        && x.abs() < MAX_COORDINATE
        && y.abs() < MAX_COORDINATE;
    let round = |s: f64| if valid { (s * 256.0).round() as i64 } else { 0 };
    // The reciprocal of the distance is affine in image space.
    Point { x: round(x), y: round(y), z: -(distance.recip() as f32), inverse_w: 1.0, valid }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nearer_faces_hide_farther_ones() {
        let square =
            |z: f64, size: f64| [[0.0, 0.0, z], [size, 0.0, z], [size, size, z], [0.0, size, z]];
        let points: Vec<[f64; 3]> = [square(2.0, 4.0), square(5.0, 8.0)].concat();
        let faces = [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]];
        let seen = visible_faces(&points, &faces, 10, 9).unwrap();
        for (at, face) in seen.iter().enumerate() {
            let (x, y) = (at % 10, at / 10);
            let expected = match (x, y) {
                (0..4, 0..4) => Some(0..2),
                (0..8, 0..8) => Some(2..4),
                _ => None,
            };
            match (face, expected) {
                (Some(face), Some(expected)) => assert!(expected.contains(face)),
                (face, expected) => assert!(face.is_none() && expected.is_none(), "{x} {y}"),
            }
        }
        let behind: Vec<[f64; 3]> = points.iter().map(|&[x, y, _]| [x, y, -1.0]).collect();
        assert!(visible_faces(&behind, &faces, 4, 4).unwrap().iter().all(Option::is_none));
        assert!(visible_faces(&points, &[[0, 1, 8]], 4, 4).is_err());
        assert!(visible_faces(&points, &faces, 0, 4).is_err());
    }
}
