//! Soft silhouettes (Liu et al. 2019, *Soft Rasterizer*): the coverage of each pixel as a smooth
//! function of the vertices.
//!
//! A triangle covers a pixel by `D = sigmoid(±d² / σ²)`, with the distance `d` of the pixel's
//! centre from the outline of the triangle, positive inside, and a surface by `A = 1 − Π (1 − D)`,
//! which converges to hard rendering for `σ → 0`. With `t = ±d² / σ²` the derivative is `∂A/∂t = (1
//! − A) D`; that of `d²` with respect to the ends of the nearest side follows from the position of
//! the nearest point on it. Many small triangles at an outline add up: the silhouette is about σ
//! wider than the surface, so σ should be below a pixel.
//!
//! The image is divided into bands of rows, independent of the number of threads, whose gradients
//! are added in order: results are deterministic to the last bit.

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use crate::{Error, PinholeCamera, Result, camera::depth};

/// Rows of pixels in a band.
const BAND: usize = 16;
/// Cut-off of `−t` beyond which a triangle is neglected: sigmoid(−9) is 1/8000. Its contribution is
/// subtracted everywhere, so that the coverage is continuous.
const FAINT: f64 = 9.0;
/// Least depth of rendered triangles, metres.
const NEAREST: f64 = 0.05;

/// Soft rendering of a surface.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use cape_fit::{PinholeCamera, silhouette::render_softly};
/// use glam::DVec3;
///
/// // A square with a side of 50 pixels.
/// let camera = PinholeCamera::new(100, 100, Some(100.0))?;
/// let (vertices, faces) = square(1.0);
/// let soft = render_softly(&vertices, &faces, &camera, 0.5)?;
/// let area: f64 = soft.coverage().iter().sum();
/// assert!((area / 2500.0 - 1.0).abs() < 0.1);
/// // A translation does not change its area.
/// let mut forces = vec![DVec3::ZERO; 4];
/// soft.pull_back(&vertices, &vec![1.0; 100 * 100], &mut forces);
/// assert!(forces.iter().map(|force| force.x).sum::<f64>().abs() < 1e-6);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct SoftRendering<'a> {
    camera: PinholeCamera,
    faces: &'a [[u32; 3]],
    softness: f64,
    /// Projected vertices, pixels, `[V]`.
    pixels: Vec<DVec2>,
    /// Faces that overlap each band, ascending.
    bands: Vec<Vec<u32>>,
    coverage: Vec<f64>,
}

/// Renders a mesh (vertices in metres, `[V]`, triangles `[F]`) with edges `softness` pixels wide.
///
/// # Errors
/// If a face index is out of range, or the softness is not positive.
pub fn render_softly<'a>(
    vertices: &[DVec3],
    faces: &'a [[u32; 3]],
    camera: &PinholeCamera,
    softness: f64,
) -> Result<SoftRendering<'a>> {
    check_softness(softness)?;
    let outside = |face: &&[u32; 3]| face.iter().any(|&at| at as usize >= vertices.len());
    if let Some(face) = faces.iter().find(outside) {
        let count = vertices.len();
        return Err(Error::argument(format!("face {face:?}, expected indices below {count}")));
    }
    Ok(draw(vertices, faces, camera, softness))
}

pub(super) fn check_softness(softness: f64) -> Result<()> {
    if softness > 0.0 && softness.is_finite() {
        return Ok(());
    }
    Err(Error::argument(format!("softness {softness} pixels, expected above 0")))
}

/// [`render_softly`] with valid faces and softness.
pub(super) fn draw<'a>(
    vertices: &[DVec3],
    faces: &'a [[u32; 3]],
    camera: &PinholeCamera,
    softness: f64,
) -> SoftRendering<'a> {
    let pixels: Vec<DVec2> = vertices.iter().map(|&vertex| camera.project(vertex)).collect();
    let (width, height) = (camera.width() as usize, camera.height() as usize);
    let reach = softness * FAINT.sqrt();
    let mut bands = vec![Vec::new(); height.div_ceil(BAND)];
    for (index, face) in faces.iter().enumerate() {
        if face.iter().any(|&corner| depth(vertices[corner as usize]) <= NEAREST) {
            continue;
        }
        let corners = face.map(|corner| pixels[corner as usize]);
        let rows = span(corners.map(|corner| corner.y), reach, height);
        if rows.is_empty() || span(corners.map(|corner| corner.x), reach, width).is_empty() {
            continue;
        }
        for band in &mut bands[rows.start / BAND..=(rows.end - 1) / BAND] {
            band.push(index as u32);
        }
    }
    let mut coverage = vec![0.0; width * height];
    let mut rendering =
        SoftRendering { camera: *camera, faces, softness, pixels, bands, coverage: Vec::new() };
    coverage.par_chunks_mut(BAND * width).enumerate().for_each(|(band, slots)| {
        // Logarithms of the uncovered share.
        let nothing = softplus(-FAINT);
        rendering.each(band, |at, fragment| slots[at] -= softplus(fragment.t) - nothing);
        for slot in slots {
            *slot = 1.0 - slot.exp();
        }
    });
    rendering.coverage = coverage;
    rendering
}

impl SoftRendering<'_> {
    /// Coverage of each pixel, 0 to 1, `[height · width]`.
    pub fn coverage(&self) -> &[f64] {
        &self.coverage
    }

    /// Adds the gradient of a function of the coverage with respect to the vertices to `forces`
    /// `[V]`; `by_coverage` `[height · width]` is its gradient with respect to the coverage.
    pub fn pull_back(&self, vertices: &[DVec3], by_coverage: &[f64], forces: &mut [DVec3]) {
        let width = self.camera.width() as usize;
        let band_gradient = |band: usize| {
            let first = band * BAND * width;
            let mut sums: Vec<(u32, DVec2)> = Vec::new();
            self.each(band, |at, fragment| {
                let left = 1.0 - self.coverage[first + at];
                let by = by_coverage[first + at] * left;
                if by != 0.0 {
                    let [start, end] = fragment.by_ends(by * sigmoid(fragment.t));
                    add(&mut sums, fragment.side[0], start);
                    add(&mut sums, fragment.side[1], end);
                }
            });
            sums
        };
        let bands: Vec<Vec<(u32, DVec2)>> =
            (0..self.bands.len()).into_par_iter().map(band_gradient).collect();
        let mut by_pixels = vec![DVec2::ZERO; vertices.len()];
        for (vertex, sum) in bands.into_iter().flatten() {
            by_pixels[vertex as usize] += sum;
        }
        for ((force, &vertex), by) in forces.iter_mut().zip(vertices).zip(by_pixels) {
            *force += self.camera.pull_back(vertex, by);
        }
    }

    /// Calls `with` for each pixel of a band, counted from its first, and each triangle that covers
    /// it, in a fixed order.
    fn each(&self, band: usize, mut with: impl FnMut(usize, Fragment)) {
        let (width, height) = (self.camera.width() as usize, self.camera.height() as usize);
        let reach = self.softness * FAINT.sqrt();
        let (first, end) = (band * BAND, ((band + 1) * BAND).min(height));
        for &face in &self.bands[band] {
            let corners = self.faces[face as usize];
            let at = corners.map(|corner| self.pixels[corner as usize]);
            let rows = span(at.map(|p| p.y), reach, height);
            let columns = span(at.map(|p| p.x), reach, width);
            for row in rows.start.max(first)..rows.end.min(end) {
                for column in columns.clone() {
                    let centre = DVec2::new(column as f64 + 0.5, row as f64 + 0.5);
                    let fragment = Fragment::new(centre, corners, at, self.softness);
                    if fragment.t > -FAINT {
                        with((row - first) * width + column, fragment);
                    }
                }
            }
        }
    }
}

/// Adds `by` to the sum of a vertex if it is among the last four, else begins a new one:
/// consecutive pixels have the same triangle.
fn add(sums: &mut Vec<(u32, DVec2)>, vertex: u32, by: DVec2) {
    match sums.iter_mut().rev().take(4).find(|(known, _)| *known == vertex) {
        Some((_, sum)) => *sum += by,
        None => sums.push((vertex, by)),
    }
}

/// Coverage of a pixel by a triangle.
#[derive(Debug, Clone, Copy)]
struct Fragment {
    /// `±d² / σ²`, positive inside.
    t: f64,
    /// Ends of the nearest side, and position of the nearest point on it, 0 to 1.
    side: [u32; 2],
    along: f64,
    /// `±2 / σ²` times the vector from the nearest point to the pixel.
    pull: DVec2,
}

impl Fragment {
    fn new(centre: DVec2, corners: [u32; 3], at: [DVec2; 3], softness: f64) -> Self {
        let (mut nearest, mut least) = ((0, 0.0, DVec2::ZERO), f64::INFINITY);
        let mut turns = [0.0; 3];
        for side in 0..3 {
            let (a, b) = (at[side], at[(side + 1) % 3]);
            let (edge, from) = (b - a, centre - a);
            turns[side] = edge.perp_dot(from);
            let along = from.dot(edge) / edge.length_squared().max(f64::MIN_POSITIVE);
            let along = along.clamp(0.0, 1.0);
            let off = from - edge * along;
            let square = off.length_squared();
            if square < least {
                (nearest, least) = ((side, along, off), square);
            }
        }
        let inside = turns.iter().all(|&turn| turn > 0.0) || turns.iter().all(|&turn| turn < 0.0);
        let scale = if inside { 1.0 } else { -1.0 } / (softness * softness);
        let (side, along, off) = nearest;
        Self {
            t: scale * least,
            side: [corners[side], corners[(side + 1) % 3]],
            along,
            pull: off * (2.0 * scale),
        }
    }

    /// Gradients with respect to the ends of the side, from the gradient `by` with respect to `t`.
    fn by_ends(&self, by: f64) -> [DVec2; 2] {
        [self.pull * (-by * (1.0 - self.along)), self.pull * (-by * self.along)]
    }
}

/// Range of pixels with centres within `reach` of the range of three coordinates.
fn span(at: [f64; 3], reach: f64, count: usize) -> std::ops::Range<usize> {
    let low = at.iter().copied().fold(f64::INFINITY, f64::min) - reach - 0.5;
    let high = at.iter().copied().fold(f64::NEG_INFINITY, f64::max) + reach - 0.5;
    // Values out of range and NaN are clamped.
    let start = low.ceil().max(0.0) as usize;
    let end = ((high.floor() + 1.0).max(0.0) as usize).min(count);
    start.min(end)..end
}

fn sigmoid(t: f64) -> f64 {
    1.0 / (1.0 + (-t).exp())
}

/// Softplus `log(1 + eᵗ)`.
fn softplus(t: f64) -> f64 {
    t.max(0.0) + (-t.abs()).exp().ln_1p()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        silhouette::render,
        testing::{BODY, assert_gradient},
    };

    fn body(width: f64, right: f64) -> Vec<DVec3> {
        let rows = BODY.v_template.rows().into_iter();
        rows.map(|v| DVec3::new(width * v[0] + right, v[1] + 0.3, v[2] - 3.0)).collect()
    }

    fn few() -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let at = [[-0.4, -0.3], [0.5, -0.4], [0.1, 0.6], [0.6, 0.5], [-0.5, 0.4]];
        let depth = |i: usize| -2.0 - 0.1 * i as f64;
        let vertices = at.iter().enumerate().map(|(i, &[x, y])| DVec3::new(x, y, depth(i)));
        (vertices.collect(), vec![[0, 1, 2], [1, 3, 2], [4, 0, 2], [4, 2, 1]])
    }

    #[test]
    fn the_gradient_agrees_with_finite_differences() {
        let (vertices, faces) = few();
        let camera = PinholeCamera::new(40, 37, None).unwrap();
        let weights: Vec<f64> = (0..40 * 37).map(|i| (f64::from(i) * 0.37).sin()).collect();
        let at = |x: &[f64]| -> Vec<DVec3> {
            x.as_chunks::<3>().0.iter().map(|&v| DVec3::from_array(v)).collect()
        };
        let value = |x: &[f64]| -> f64 {
            let soft = render_softly(&at(x), &faces, &camera, 2.0).unwrap();
            soft.coverage().iter().zip(&weights).map(|(a, w)| a * w).sum()
        };
        let x: Vec<f64> = vertices.iter().flat_map(DVec3::to_array).collect();
        let mut forces = vec![DVec3::ZERO; vertices.len()];
        let soft = render_softly(&vertices, &faces, &camera, 2.0).unwrap();
        soft.pull_back(&vertices, &weights, &mut forces);
        let gradient: Vec<f64> = forces.iter().flat_map(DVec3::to_array).collect();
        assert_gradient(&x, &gradient, 1e-3, value);
    }

    /// Hard rendering, also supersampled.
    #[test]
    fn without_softness_it_is_what_a_renderer_covers() {
        let vertices = body(1.0, 0.0);
        let faces = &BODY.faces;
        let camera = PinholeCamera::new(96, 96, None).unwrap();
        let hard = render(&vertices, faces, &camera).unwrap();
        let soft = render_softly(&vertices, faces, &camera, 1e-3).unwrap();
        let pairs = || soft.coverage().iter().zip(hard.mask().covered());
        let off = pairs().filter(|&(a, &b)| (a - f64::from(b)).abs() > 0.01).count();
        assert!(off <= 12, "{off} pixels");

        // Supersampled four times in both directions.
        let fine = PinholeCamera::new(384, 384, None).unwrap();
        let covered = render(&vertices, faces, &fine).unwrap().mask().clone();
        let soft = render_softly(&vertices, faces, &fine, 1e-3).unwrap();
        let mean = |at: usize, of: &dyn Fn(usize) -> f64| {
            let (x, y) = (at % 96 * 4, at / 96 * 4);
            (0..16).map(|i| of((y + i / 4) * 384 + x + i % 4)).sum::<f64>() / 16.0
        };
        for at in 0..96 * 96 {
            let supersampled = mean(at, &|i| f64::from(covered.covered()[i]));
            let softly = mean(at, &|i| soft.coverage()[i]);
            assert!((supersampled - softly).abs() < 0.13, "{at}: {supersampled} {softly}");
        }
    }

    #[test]
    fn threads_do_not_change_a_bit() {
        let camera = PinholeCamera::new(128, 120, None).unwrap();
        let vertices = body(1.0, 0.0);
        let gradient = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let soft = render_softly(&vertices, &BODY.faces, &camera, 1.0).unwrap();
                let mut forces = vec![DVec3::ZERO; vertices.len()];
                soft.pull_back(&vertices, soft.coverage(), &mut forces);
                (soft.coverage().to_vec(), forces)
            })
        };
        assert_eq!(gradient(1), gradient(3));
        assert!(render_softly(&vertices, &[[0, 1, 99_999]], &camera, 1.0).is_err());
        assert!(render_softly(&vertices, &BODY.faces, &camera, 0.0).is_err());
        let away: Vec<DVec3> = vertices.iter().map(|v| DVec3::new(v.x, v.y, -v.z)).collect();
        let empty = render_softly(&away, &BODY.faces, &camera, 1.0).unwrap();
        assert!(empty.coverage().iter().all(|&a| a == 0.0));
    }
}
