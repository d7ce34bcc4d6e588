//! Lighting: key light with shadow map, fill light, rim light, and ambient light with occlusion.

use std::sync::LazyLock;

use cape_core::Mesh;
use glam::{Mat4, Vec3, camera::rh::proj::directx};
use rayon::prelude::*;

use crate::{
    Bounds,
    camera::Camera,
    raster::{Point, rasterise},
};

/// Number of directions of ambient occlusion.
const SKY_DIRECTIONS: usize = 16;
/// Side of the depth map of each direction, samples.
const SKY_MAP: usize = 128;
/// Side of the shadow map of the key light, samples.
const KEY_MAP: usize = 768;

/// Reflectance of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Material {
    /// sRGB colour, 0 to 1, of objects without vertex colours.
    pub colour: [f32; 3],
    /// Strength of the specular highlight, 0 (cloth) to 1 (polished).
    pub gloss: f32,
}

impl Default for Material {
    fn default() -> Self {
        Self { colour: [0.74, 0.74, 0.76], gloss: 0.12 }
    }
}

/// Area-weighted unit normals of the vertices, `[vertices]`; zero without non-degenerate faces.
pub(crate) fn vertex_normals(mesh: &Mesh) -> Vec<Vec3> {
    let mut normals = vec![Vec3::ZERO; mesh.vertices.len()];
    for &face in &mesh.faces {
        let [a, b, c] = face.map(|i| Vec3::from(mesh.vertices[i as usize]));
        let normal = (b - a).cross(c - a);
        for i in face {
            normals[i as usize] += normal;
        }
    }
    normals.into_iter().map(Vec3::normalize_or_zero).collect()
}

pub(crate) fn to_linear(srgb: [f32; 3]) -> Vec3 {
    let decode = |s: f32| if s <= 0.04045 { s / 12.92 } else { ((s + 0.055) / 1.055).powf(2.4) };
    Vec3::from(srgb.map(|s| decode(s.clamp(0.0, 1.0))))
}

/// Entries of the sRGB table; near black, where the curve is steepest, an entry is a fifth of an 8-bit
/// step.
const SRGB_STEPS: usize = 16_384;

pub(crate) fn to_srgb(linear: Vec3) -> [u8; 3] {
    static TABLE: LazyLock<Vec<u8>> = LazyLock::new(|| {
        let encode = |step: usize| {
            let l = step as f32 / SRGB_STEPS as f32;
            let s = if l <= 0.0031308 { 12.92 * l } else { 1.055 * l.powf(1.0 / 2.4) - 0.055 };
            (s * 255.0).round() as u8
        };
        (0..=SRGB_STEPS).map(encode).collect()
    });
    let table = &**TABLE;
    let steps = linear.clamp(Vec3::ZERO, Vec3::ONE) * SRGB_STEPS as f32 + 0.5;
    steps.to_array().map(|step| table[step as usize])
}

/// Orthographic depth map of the scene.
struct DepthMap {
    matrix: Mat4,
    side: usize,
    depth: Vec<f32>,
    /// Width of a sample, metres.
    texel: f32,
    /// Distance from depth 0 to depth 1, metres.
    range: f32,
}

impl DepthMap {
    fn new(
        vertices: &[Vec3],
        faces: &[[u32; 3]],
        bounds: &Bounds,
        from: Vec3,
        side: usize,
    ) -> Self {
        let radius = bounds.radius() * 1.02;
        let eye = bounds.centre() + from * radius;
        let range = 2.0 * radius;
        let projection = directx::orthographic(-radius, radius, -radius, radius, 0.0, range);
        let matrix = Camera::new(eye, bounds.centre(), projection, true).clip;
        let points: Vec<_> = vertices
            .iter()
            .map(|&v| Point::project((matrix * v.extend(1.0)).to_array(), side, side))
            .collect();
        let depth = rasterise(&points, faces, side, side).depth;
        Self { matrix, side, depth, texel: range / side as f32, range }
    }

    /// Visibility of the light at `point`, 0 to 1: mean of `TAPS`×`TAPS` bilinear samples. `EDGE` is
    /// `TAPS + 1`.
    fn visibility<const TAPS: usize, const EDGE: usize>(&self, point: Vec3, bias: f32) -> f32 {
        const { assert!(EDGE == TAPS + 1) };
        let clip = self.matrix.project_point3(point);
        let x = (clip.x * 0.5 + 0.5) * self.side as f32 - 0.5;
        let y = (0.5 - clip.y * 0.5) * self.side as f32 - 0.5;
        let limit = clip.z - bias / self.range;
        // The border samples of the box get the fractional weights.
        let weights = |f: f32| {
            let mut weights = [1.0; EDGE];
            (weights[0], weights[TAPS]) = (1.0 - f, f);
            weights
        };
        let across = weights(x - x.floor());
        let down = weights(y - y.floor());
        let first = |x: f32| x.floor() as i64 - (TAPS as i64 - 1) / 2;
        let (left, top) = (first(x), first(y));
        let most = self.side as i64 - EDGE as i64;
        let sum: f32 = if (0..=most).contains(&left) && (0..=most).contains(&top) {
            let row = |j: usize| {
                let start = (top as usize + j) * self.side + left as usize;
                let depths = &self.depth[start..start + EDGE];
                let lit = |i: usize| if depths[i] >= limit { across[i] } else { 0.0 };
                (0..EDGE).map(lit).sum::<f32>()
            };
            (0..EDGE).map(|j| down[j] * row(j)).sum()
        } else {
            let inside = 0..self.side as i64;
            let lit = |i: usize, j: usize| {
                let (column, row) = (left + i as i64, top + j as i64);
                let free = !inside.contains(&column)
                    || !inside.contains(&row)
                    || self.depth[row as usize * self.side + column as usize] >= limit;
                f32::from(free)
            };
            let row = |j: usize| (0..EDGE).map(|i| across[i] * lit(i, j)).sum::<f32>();
            (0..EDGE).map(|j| down[j] * row(j)).sum()
        };
        sum / (TAPS * TAPS) as f32
    }
}

/// Lights fixed to the camera, with the shadow map of the key light.
pub(crate) struct Lights {
    key: Vec3,
    fill: Vec3,
    rim: Vec3,
    shadow: Option<DepthMap>,
}

/// Shading inputs of one surface point.
pub(crate) struct ShadingPoint {
    pub(crate) position: Vec3,
    /// Unit normal on the side of the camera.
    pub(crate) normal: Vec3,
    /// Unit vector towards the camera.
    pub(crate) eye: Vec3,
    /// Linear albedo.
    pub(crate) albedo: Vec3,
    /// Ambient visibility (1 − occlusion), 0 to 1.
    pub(crate) sky: f32,
    pub(crate) gloss: f32,
}

impl Lights {
    pub(crate) fn new(
        camera: &Camera,
        vertices: &[Vec3],
        faces: &[[u32; 3]],
        bounds: &Bounds,
        shadows: bool,
    ) -> Self {
        let inverse = camera.view.inverse();
        let world = |x, y, z| inverse.transform_vector3(Vec3::new(x, y, z)).normalize();
        let key = world(-0.62, 0.75, 0.72);
        let shadow = shadows.then(|| DepthMap::new(vertices, faces, bounds, key, KEY_MAP));
        Self { key, fill: world(0.9, 0.12, 0.55), rim: world(0.55, 0.55, -0.85), shadow }
    }

    /// Linear radiance of `surface` towards the camera.
    pub(crate) fn shade(&self, surface: &ShadingPoint) -> Vec3 {
        const KEY: Vec3 = Vec3::new(1.32, 1.25, 1.16);
        const FILL: Vec3 = Vec3::new(0.20, 0.25, 0.33);
        const RIM: Vec3 = Vec3::new(0.85, 0.90, 1.0);
        const SKY: Vec3 = Vec3::new(0.30, 0.33, 0.385);
        const GROUND: Vec3 = Vec3::new(0.16, 0.14, 0.13);
        let ShadingPoint { position, normal, eye, albedo, sky, gloss } = *surface;
        let facing = normal.dot(self.key);
        let key = match &self.shadow {
            Some(map) if facing > 0.0 => {
                let slope = (1.0 - facing * facing).max(0.0).sqrt();
                let lifted = position + normal * (2.0 * map.texel * slope);
                facing * map.visibility::<5, 6>(lifted, 1.5 * map.texel)
            }
            _ => facing.max(0.0),
        };
        let ambient = SKY.lerp(GROUND, 0.5 - 0.5 * normal.y) * sky;
        let mut light = ambient + KEY * key + FILL * (normal.dot(self.fill).max(0.0) * sky);
        let grazing = 1.0 - normal.dot(eye).clamp(0.0, 1.0);
        let rim = normal.dot(self.rim).max(0.0) * grazing * grazing;
        light += RIM * (rim * sky * 1.6);
        let half = (self.key + eye).normalize_or_zero();
        let highlight = normal.dot(half).max(0.0).powi(28) * key.min(1.0);
        let sheen = grazing.powi(4) * sky;
        albedo * light + KEY * (gloss * (0.35 * highlight + 0.10 * sheen))
    }
}

/// Ambient visibility of each vertex, cosine-weighted over depth maps around the scene, `[vertices]`.
pub(crate) fn sky_visibility(
    vertices: &[Vec3],
    normals: &[Vec3],
    faces: &[[u32; 3]],
    bounds: &Bounds,
) -> Vec<f32> {
    let maps: Vec<(Vec3, f32, DepthMap)> = (0..SKY_DIRECTIONS)
        .into_par_iter()
        .map(|i| {
            // Fibonacci spiral; directions from below count less, as the floor reflects some light.
            let y = 1.0 - (2 * i + 1) as f32 / SKY_DIRECTIONS as f32;
            let angle = i as f32 * 2.399_963_2;
            let direction =
                Vec3::new(angle.cos(), 0.0, angle.sin()) * (1.0 - y * y).sqrt() + Vec3::Y * y;
            let weight = if y > -0.1 { 1.0 } else { 0.55 };
            (direction, weight, DepthMap::new(vertices, faces, bounds, direction, SKY_MAP))
        })
        .collect();
    vertices
        .par_iter()
        .zip(normals)
        .map(|(&vertex, &normal)| {
            let (mut visible, mut all) = (0.0, 0.0);
            for (direction, weight, map) in &maps {
                let cosine = normal.dot(*direction);
                if cosine > 0.05 {
                    let lifted = vertex + normal * (1.2 * map.texel);
                    all += weight * cosine;
                    visible += weight * cosine * map.visibility::<1, 2>(lifted, 0.8 * map.texel);
                }
            }
            if all > 0.0 { visible / all } else { 1.0 }
        })
        .collect()
}

/// Contact shadow on the floor below the scene.
pub(crate) struct ContactShadow {
    /// Height of the floor, metres.
    pub(crate) y: f32,
    origin: [f32; 2],
    texel: f32,
    side: usize,
    dark: Vec<f32>,
}

impl ContactShadow {
    pub(crate) fn new(vertices: &[Vec3], faces: &[[u32; 3]], bounds: &Bounds) -> Self {
        const SIDE: usize = 192;
        /// Fading heights of the shadow above the floor, relative to the radius of the scene.
        const FADE: [f32; 2] = [0.02, 0.16];
        let radius = bounds.radius() * 1.6;
        let centre = bounds.centre();
        let texel = 2.0 * radius / SIDE as f32;
        let origin = [centre.x - radius, centre.z - radius];
        let points: Vec<_> = vertices
            .iter()
            .map(|v| Point {
                x: ((v.x - origin[0]) / texel * 256.0).round() as i64,
                y: ((v.z - origin[1]) / texel * 256.0).round() as i64,
                z: v.y - bounds.min.y,
                inverse_w: 1.0,
                valid: true,
            })
            .collect();
        let height = rasterise(&points, faces, SIDE, SIDE).depth;
        let layer = |fade: f32, blur: f32| {
            let mut dark: Vec<f32> =
                height.iter().map(|h| (-h / (fade * bounds.radius())).exp()).collect();
            let reach = (blur * bounds.radius() / texel).round().max(1.0) as usize;
            for _ in 0..3 {
                dark = box_blur(&dark, SIDE, reach);
                dark = box_blur(&dark, SIDE, reach);
            }
            dark
        };
        let (near, far) = (layer(FADE[0], 0.012), layer(FADE[1], 0.06));
        let dark = near.iter().zip(&far).map(|(n, f)| 1.0 - (1.0 - 0.6 * n) * (1.0 - 0.5 * f));
        Self { y: bounds.min.y, origin, texel, side: SIDE, dark: dark.collect() }
    }

    /// Darkness of the floor at (`x`, `z`), 0 to 1.
    pub(crate) fn at(&self, x: f32, z: f32) -> f32 {
        let u = (x - self.origin[0]) / self.texel - 0.5;
        let v = (z - self.origin[1]) / self.texel - 0.5;
        let limit = (self.side - 1) as f32;
        if !(u >= 0.0 && v >= 0.0 && u < limit && v < limit) {
            return 0.0;
        }
        let (i, j) = (u as usize, v as usize);
        let (fu, fv) = (u - i as f32, v - j as f32);
        let row = |j: usize| {
            let start = j * self.side + i;
            self.dark[start] * (1.0 - fu) + self.dark[start + 1] * fu
        };
        row(j) * (1.0 - fv) + row(j + 1) * fv
    }
}

/// Box filter along rows with transposed output; values outside are zero.
fn box_blur(values: &[f32], side: usize, reach: usize) -> Vec<f32> {
    let mut out = vec![0.0; values.len()];
    let scale = 1.0 / (2 * reach + 1) as f32;
    for (row, line) in values.chunks_exact(side).enumerate() {
        let mut sum: f32 = line.iter().take(reach).sum();
        for column in 0..side {
            sum += line.get(column + reach).copied().unwrap_or(0.0);
            if column > reach {
                sum -= line[column - reach - 1];
            }
            out[column * side + row] = sum * scale;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_encoding_inverts_decoding() {
        for value in 0..=255_u8 {
            let linear = to_linear([f32::from(value) / 255.0; 3]);
            assert_eq!(to_srgb(linear), [value; 3]);
        }
    }

    #[test]
    fn blurring_twice_keeps_orientation_and_mass() {
        let mut values = vec![0.0; 81];
        values[3 * 9 + 5] = 9.0;
        let blurred = box_blur(&box_blur(&values, 9, 1), 9, 1);
        assert!((blurred.iter().sum::<f32>() - 9.0).abs() < 1e-4);
        for row in 0..9 {
            for column in 0..9 {
                let inside = (2..5).contains(&row) && (4..7).contains(&column);
                let expected = if inside { 1.0 } else { 0.0 };
                assert!((blurred[row * 9 + column] - expected).abs() < 1e-4);
            }
        }
    }

    #[test]
    fn a_floor_under_a_roof_is_in_shadow_and_the_roof_is_lit() {
        let quad = |y: f32, half: f32| {
            [[-half, y, -half], [-half, y, half], [half, y, half], [half, y, -half]].map(Vec3::from)
        };
        let vertices: Vec<Vec3> = quad(0.0, 1.0).into_iter().chain(quad(0.3, 0.5)).collect();
        let faces = [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]];
        let bounds = Bounds { min: Vec3::new(-1.0, 0.0, -1.0), max: Vec3::new(1.0, 0.3, 1.0) };
        let map = DepthMap::new(&vertices, &faces, &bounds, Vec3::Y, 256);
        assert_eq!(map.visibility::<3, 4>(Vec3::new(0.0, 0.0, 0.0), 0.01), 0.0);
        assert_eq!(map.visibility::<3, 4>(Vec3::new(0.0, 0.3, 0.0), 0.01), 1.0);
        assert_eq!(map.visibility::<3, 4>(Vec3::new(0.8, 0.0, 0.8), 0.01), 1.0);
        let edge = map.visibility::<3, 4>(Vec3::new(0.5, 0.0, 0.0), 0.01);
        assert!(edge > 0.05 && edge < 0.95, "{edge}");
    }
}
