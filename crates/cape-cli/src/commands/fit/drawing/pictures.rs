//! Pictures of fits from the image's camera.

use cape_core::Mesh;
use cape_fit::{Keypoints, Mask, PinholeCamera, keypoints::Keypoint};
use cape_render::{Background, Image, Material, Object, Style};
use glam::DVec3;

use crate::error::Result;

const PAPER: [u8; 4] = [245, 245, 247, 255];
const CLAY: Material = Material { colour: [0.72, 0.71, 0.70], gloss: 0.05 };
/// Half the side of a keypoint's mark in an image of [`MARKED`] pixels, pixels.
const MARK: f64 = 2.5;
const MARKED: f64 = 512.0;

/// An empty picture of the camera's size.
pub(crate) fn paper(camera: &PinholeCamera) -> Result<Image> {
    Ok(Image::new(camera.width(), camera.height(), PAPER)?)
}

/// Draws a surface, in colours or in clay, over `picture` of the camera's size.
pub(crate) fn body(
    picture: &mut Image,
    vertices: &[DVec3],
    faces: &[[u32; 3]],
    colours: Option<&[[f32; 3]]>,
    camera: &PinholeCamera,
) -> Result {
    let mesh = mesh(vertices, faces);
    let depths = || vertices.iter().map(|vertex| -vertex.z);
    let near = depths().fold(f64::INFINITY, f64::min).max(0.1);
    let far = depths().fold(near + 0.1, f64::max);
    let style = Style {
        width: camera.width(),
        height: camera.height(),
        samples: 2,
        background: Background::Transparent,
        floor: false,
        shadows: true,
    };
    let object = Object { material: CLAY, colours, ..Object::new(&mesh) };
    let camera = camera.to_render([0.9 * near, 1.1 * far]);
    picture.draw(&cape_render::render(&[object], &camera, &style)?, 0, 0);
    Ok(())
}

pub(crate) fn mesh(vertices: &[DVec3], faces: &[[u32; 3]]) -> Mesh {
    let vertices = vertices.iter().map(|v| v.to_array().map(|x| x as f32)).collect();
    Mesh { vertices, faces: faces.to_vec() }
}

/// Tints what only the mask covers red, what only the fit covers blue, what both cover green.
pub(crate) fn difference(picture: &mut Image, mask: &Mask, fitted: &Mask) {
    let width = mask.width() as usize;
    for (at, (&wanted, &found)) in mask.covered().iter().zip(fitted.covered()).enumerate() {
        let colour = match (wanted, found) {
            (false, false) => continue,
            (true, false) => [214, 69, 65],
            (false, true) => [65, 105, 214],
            (true, true) => [90, 170, 110],
        };
        picture.blend((at % width) as i64, (at / width) as i64, colour, 0.55);
    }
}

/// Covers the pixels of occluders with grey.
pub(crate) fn hide(picture: &mut Image, occluders: &Mask) {
    let width = occluders.width() as usize;
    for (at, _) in occluders.covered().iter().enumerate().filter(|(_, hidden)| **hidden) {
        picture.blend((at % width) as i64, (at / width) as i64, [150, 150, 150], 0.8);
    }
}

/// Marks the keypoints, more opaque with confidence.
pub(crate) fn mark(picture: &mut Image, keypoints: &Keypoints) {
    let side = f64::from(picture.width().max(picture.height()));
    let reach = (MARK * side / MARKED).max(1.0).round() as i64;
    for &Keypoint { x, y, confidence } in keypoints.points() {
        if confidence <= 0.0 {
            continue;
        }
        for (dx, dy) in (-reach..=reach).flat_map(|dx| (-reach..=reach).map(move |dy| (dx, dy))) {
            let opacity = 0.3 + 0.7 * confidence as f32;
            picture.blend(x.floor() as i64 + dx, y.floor() as i64 + dy, [240, 150, 20], opacity);
        }
    }
}

/// Bounding box of all `masks`, `[left, top, right, bottom]`, with a margin of a twentieth of the image.
pub(crate) fn person_box(masks: &[Mask]) -> Option<[u32; 4]> {
    let mut found: Option<[u32; 4]> = None;
    for mask in masks {
        for (at, _) in mask.covered().iter().enumerate().filter(|(_, covered)| **covered) {
            let (x, y) = (at as u32 % mask.width(), at as u32 / mask.width());
            let [left, top, right, bottom] = found.unwrap_or([x, y, x + 1, y + 1]);
            found = Some([left.min(x), top.min(y), right.max(x + 1), bottom.max(y + 1)]);
        }
    }
    let (mask, [left, top, right, bottom]) = (masks.first()?, found?);
    let margin = mask.width().max(mask.height()) / 20;
    Some([
        left.saturating_sub(margin),
        top.saturating_sub(margin),
        (right + margin).min(mask.width()),
        (bottom + margin).min(mask.height()),
    ])
}

/// The part of a picture within a box `[left, top, right, bottom]`.
pub(crate) fn cut(picture: &Image, [left, top, right, bottom]: [u32; 4]) -> Result<Image> {
    let mut part = Image::new(right - left, bottom - top, PAPER)?;
    part.draw(picture, -i64::from(left), -i64::from(top));
    Ok(part)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn people_are_boxed_and_cut_out() {
        let covered = (0..100 * 60).map(|at| (30..50).contains(&(at % 100)) && at / 100 > 20);
        let mask = Mask::new(100, 60, covered.collect()).unwrap();
        let found = person_box(&[mask]).unwrap();
        assert_eq!(found, [25, 16, 55, 60]);
        let mut picture = Image::new(100, 60, [9, 9, 9, 255]).unwrap();
        picture.blend(30, 20, [200, 0, 0], 1.0);
        let part = cut(&picture, found).unwrap();
        assert_eq!((part.width(), part.height()), (30, 44));
        assert_eq!(part.get(5, 4), Some([200, 0, 0, 255]));
        let nobody = Mask::new(4, 4, vec![false; 16]).unwrap();
        assert_eq!(person_box(&[nobody]), None);
    }
}
