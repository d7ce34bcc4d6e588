//! Exact distance transforms in linear time.
//!
//! Both metrics are separable: the nearest covered pixel is found in each column first, then among
//! these along each row, by the lower envelope of parabolas for the Euclidean distance
//! (Felzenszwalb and Huttenlocher 2012) and by one pass in each direction for the Manhattan
//! distance.

use super::Mask;
use crate::Result;

/// Distance of each pixel to the nearest covered pixel, and the index of that pixel.
///
/// ```
/// use cape_fit::{Mask, silhouette::{euclidean, manhattan}};
///
/// // Only the upper left pixel is covered; the distance of the lower right one.
/// let covered = (0..5 * 4).map(|pixel| pixel == 0).collect();
/// let mask = Mask::new(5, 4, covered)?;
/// assert_eq!((euclidean(&mask).distance()[19], manhattan(&mask).distance()[19]), (5.0, 7.0));
/// assert_eq!(euclidean(&mask).site()[19], 0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct DistanceField {
    width: usize,
    distance: Vec<f64>,
    site: Vec<u32>,
}

impl DistanceField {
    /// Distances, pixels, `[height · width]`; infinite if no pixel is covered.
    pub fn distance(&self) -> &[f64] {
        &self.distance
    }

    /// Indices of the nearest covered pixels, `[height · width]`; undefined if no pixel is covered.
    pub fn site(&self) -> &[u32] {
        &self.site
    }

    /// Distance at a column and row, pixels, and its gradient, by Catmull–Rom interpolation between
    /// the pixel centres, where it is exact. Unlike bilinear interpolation it has no kinks at the
    /// centres, at which surfaces are matched. Outside the image the distance from the image is
    /// added.
    pub fn sample(&self, x: f64, y: f64) -> (f64, [f64; 2]) {
        let height = self.distance.len() / self.width;
        let (columns, beyond_x) = InterpolationTaps::new(x - 0.5, self.width);
        let (rows, beyond_y) = InterpolationTaps::new(y - 0.5, height);
        let (mut value, mut slope_x, mut slope_y) = (0.0, 0.0, 0.0);
        for i in 0..4 {
            let row = &self.distance[rows.at[i] * self.width..][..self.width];
            let along = |weights: &[f64; 4]| -> f64 {
                (0..4).map(|j| weights[j] * row[columns.at[j]]).sum()
            };
            let here = along(&columns.weights);
            value += rows.weights[i] * here;
            slope_x += rows.weights[i] * along(&columns.slopes);
            slope_y += rows.slopes[i] * here;
        }
        let along = |beyond: f64, slope: f64| if beyond == 0.0 { slope } else { beyond.signum() };
        let value = value + beyond_x.abs() + beyond_y.abs();
        (value, [along(beyond_x, slope_x), along(beyond_y, slope_y)])
    }
}

/// The four pixel centres around a coordinate, their weights, and the derivatives of the weights.
struct InterpolationTaps {
    at: [usize; 4],
    weights: [f64; 4],
    slopes: [f64; 4],
}

impl InterpolationTaps {
    /// Taps of a coordinate among `count` pixels, and its signed distance beyond the first or last
    /// centre.
    fn new(at: f64, count: usize) -> (Self, f64) {
        let inside = at.clamp(0.0, (count - 1) as f64);
        let cell = inside.floor();
        let t = inside - cell;
        let neighbour = |i: usize| (cell as usize + i).saturating_sub(1).min(count - 1);
        let taps = Self {
            at: std::array::from_fn(neighbour),
            weights: [
                0.5 * t * (t * (2.0 - t) - 1.0),
                0.5 * (t * t * (3.0 * t - 5.0) + 2.0),
                0.5 * t * (t * (4.0 - 3.0 * t) + 1.0),
                0.5 * t * t * (t - 1.0),
            ],
            slopes: [
                0.5 * (t * (4.0 - 3.0 * t) - 1.0),
                0.5 * t * (9.0 * t - 10.0),
                0.5 * (t * (8.0 - 9.0 * t) + 1.0),
                0.5 * t * (3.0 * t - 2.0),
            ],
        };
        (taps, at - inside)
    }
}

/// Euclidean distance transform of a mask.
pub fn euclidean(mask: &Mask) -> DistanceField {
    let columns = down_columns(mask);
    let width = mask.width() as usize;
    let mut distance = Vec::with_capacity(columns.len());
    let mut site = Vec::with_capacity(columns.len());
    let mut envelope = LowerEnvelope::default();
    for row in columns.chunks_exact(width) {
        envelope.build(row);
        for x in 0..width {
            let (square, at) = envelope.lowest(x);
            distance.push(square.sqrt());
            site.push(at);
        }
    }
    DistanceField { width, distance, site }
}

/// Manhattan (L1) distance transform of a mask, as in the silhouette term of CAPE.
pub fn manhattan(mask: &Mask) -> DistanceField {
    let mut all = down_columns(mask);
    let width = mask.width() as usize;
    for row in all.chunks_exact_mut(width) {
        spread(row, 0..width);
        spread(row, (0..width).rev());
    }
    DistanceField {
        width,
        distance: all.iter().map(|site| site.distance).collect(),
        site: all.iter().map(|site| site.at).collect(),
    }
}

/// Manhattan distance to where a surface costs nothing: the covered pixels of a mask and everything
/// outside the image.
#[derive(Debug, Clone)]
pub(super) struct FreeDistance {
    /// Distances in the image with a border of one pixel, which is covered.
    field: DistanceField,
    width: f64,
    height: f64,
}

impl FreeDistance {
    /// Distance transform of a mask with its surroundings.
    pub(super) fn new(mask: &Mask) -> Result<Self> {
        let (width, height) = (mask.width() as usize, mask.height() as usize);
        let mut covered = vec![true; (width + 2) * (height + 2)];
        for (row, line) in mask.covered().chunks_exact(width).enumerate() {
            covered[(row + 1) * (width + 2) + 1..][..width].copy_from_slice(line);
        }
        let bordered = Mask::new(mask.width() + 2, mask.height() + 2, covered)?;
        let field = manhattan(&bordered);
        Ok(Self { field, width: width as f64, height: height as f64 })
    }

    /// Distance at a column and row, pixels, and its gradient; 0 outside the image.
    pub(super) fn sample(&self, x: f64, y: f64) -> (f64, [f64; 2]) {
        let near = |at: f64, side: f64| at > -0.5 && at < side + 0.5;
        if near(x, self.width) && near(y, self.height) {
            self.field.sample(x + 1.0, y + 1.0)
        } else {
            (0.0, [0.0; 2])
        }
    }
}

/// Nearest covered pixel so far, and its distance.
#[derive(Debug, Clone, Copy)]
struct NearestPixel {
    distance: f64,
    at: u32,
}

/// Nearest covered pixel of each pixel in its column.
fn down_columns(mask: &Mask) -> Vec<NearestPixel> {
    let (width, height) = (mask.width() as usize, mask.height() as usize);
    let own = |(at, &covered): (usize, &bool)| NearestPixel {
        distance: if covered { 0.0 } else { f64::INFINITY },
        at: at as u32,
    };
    let mut sites: Vec<NearestPixel> = mask.covered().iter().enumerate().map(own).collect();
    for column in 0..width {
        for row in 1..height {
            pass(&mut sites, (row - 1) * width + column, row * width + column);
        }
        for row in (1..height).rev() {
            pass(&mut sites, row * width + column, (row - 1) * width + column);
        }
    }
    sites
}

fn spread(row: &mut [NearestPixel], order: impl Iterator<Item = usize>) {
    let mut before = None;
    for at in order {
        if let Some(before) = before {
            pass(row, before, at);
        }
        before = Some(at);
    }
}

/// Propagates the nearest pixel of `from` to its neighbour `to`.
fn pass(sites: &mut [NearestPixel], from: usize, to: usize) {
    if sites[from].distance + 1.0 < sites[to].distance {
        sites[to] = NearestPixel { distance: sites[from].distance + 1.0, ..sites[from] };
    }
}

/// Lower envelope of the parabolas of a row, one for each column.
#[derive(Debug, Default)]
struct LowerEnvelope {
    /// Column and height of the apex, site, and start of the interval where the parabola is lowest.
    parabolas: Vec<(f64, f64, u32, f64)>,
    /// Index of the parabola at the last queried column.
    now: usize,
}

impl LowerEnvelope {
    fn build(&mut self, row: &[NearestPixel]) {
        self.parabolas.clear();
        self.now = 0;
        for (column, site) in row.iter().enumerate().filter(|(_, site)| site.distance.is_finite()) {
            let (x, height) = (column as f64, site.distance * site.distance);
            let mut from = f64::NEG_INFINITY;
            while let Some(&(other, above, _, start)) = self.parabolas.last() {
                // Intersection of the two parabolas.
                from = (height + x * x - above - other * other) / (2.0 * (x - other));
                if from > start {
                    break;
                }
                self.parabolas.pop();
                from = f64::NEG_INFINITY;
            }
            self.parabolas.push((x, height, site.at, from));
        }
    }

    /// Height and site at a column; columns must be queried in ascending order.
    fn lowest(&mut self, column: usize) -> (f64, u32) {
        let x = column as f64;
        while self.parabolas.get(self.now + 1).is_some_and(|next| next.3 <= x) {
            self.now += 1;
        }
        match self.parabolas.get(self.now) {
            Some(&(apex, height, site, _)) => ((x - apex) * (x - apex) + height, site),
            None => (f64::INFINITY, 0),
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::testing::assert_gradient;

    type DistanceFn = fn(f64, f64) -> f64;

    fn masks() -> impl Strategy<Value = Mask> {
        (1u32..24, 1u32..24, 0.0f64..0.5).prop_flat_map(|(width, height, share)| {
            let pixels = (width * height) as usize;
            prop::collection::vec(prop::bool::weighted(share), pixels)
                .prop_map(move |covered| Mask::new(width, height, covered).unwrap())
        })
    }

    fn brute(mask: &Mask, metric: DistanceFn) -> Vec<f64> {
        let width = mask.width() as usize;
        let covered: Vec<usize> =
            (0..mask.covered().len()).filter(|&at| mask.covered()[at]).collect();
        (0..mask.covered().len())
            .map(|at| {
                let to = |&site: &usize| between(at, site, width, metric);
                covered.iter().map(to).fold(f64::INFINITY, f64::min)
            })
            .collect()
    }

    fn between(a: usize, b: usize, width: usize, metric: DistanceFn) -> f64 {
        metric((a % width).abs_diff(b % width) as f64, (a / width).abs_diff(b / width) as f64)
    }

    proptest! {
        #[test]
        fn distances_are_those_of_brute_force(mask in masks()) {
            let l2: DistanceFn = |x, y| (x * x + y * y).sqrt();
            let l1: DistanceFn = |x, y| x + y;
            for (found, metric) in [(euclidean(&mask), l2), (manhattan(&mask), l1)] {
                let expected = brute(&mask, metric);
                prop_assert_eq!(found.distance(), &expected[..]);
                for (at, &site) in found.site().iter().enumerate() {
                    if expected[at].is_finite() {
                        prop_assert!(mask.covered()[site as usize]);
                        let own = between(at, site as usize, mask.width() as usize, metric);
                        prop_assert_eq!(own, expected[at]);
                    }
                }
            }
        }

        /// Brute force over the covered pixels and all pixels around the image.
        #[test]
        fn outside_the_image_everything_is_free(
            mask in masks(), x in -3.0f64..28.0, y in -3.0f64..28.0,
        ) {
            let free = FreeDistance::new(&mask).unwrap();
            let (width, height) = (mask.width() as i64, mask.height() as i64);
            let is_free = |x: i64, y: i64| {
                let inside = (0..width).contains(&x) && (0..height).contains(&y);
                !inside || mask.covered()[(y * width + x) as usize]
            };
            let brute = |x: i64, y: i64| {
                let all = (-1..=width).flat_map(|u| (-1..=height).map(move |v| (u, v)));
                all.filter(|&(u, v)| is_free(u, v)).map(|(u, v)| (u - x).abs() + (v - y).abs()).min()
            };
            for y in -2..height + 2 {
                for x in -2..width + 2 {
                    let expected = if is_free(x, y) { 0 } else { brute(x, y).unwrap() };
                    let found = free.sample(x as f64 + 0.5, y as f64 + 0.5).0;
                    prop_assert!((found - expected as f64).abs() < 1e-9, "{} {}: {}", x, y, found);
                }
            }
            // Away from the centres of the border's pixels, where the outside starts.
            let away = |v: f64, side: i64| (v + 0.5).abs() > 1e-3 && (v - side as f64 - 0.5).abs() > 1e-3;
            prop_assume!(away(x, width) && away(y, height));
            let (_, gradient) = free.sample(x, y);
            assert_gradient(&[x, y], &gradient, 1e-4, |p| free.sample(p[0], p[1]).0);
        }

        #[test]
        fn samples_interpolate_and_their_gradient_is_right(
            mask in masks(), x in -5.0f64..30.0, y in -5.0f64..30.0,
        ) {
            prop_assume!(mask.area() > 0);
            let field = manhattan(&mask);
            // Away from the outermost centres, where extrapolation starts.
            let height = field.distance.len() / field.width;
            let away = |v: f64, count: usize| {
                (v - 0.5).abs() > 1e-3 && (v + 0.5 - count as f64).abs() > 1e-3
            };
            prop_assume!(away(x, field.width) && away(y, height));
            let (_, gradient) = field.sample(x, y);
            assert_gradient(&[x, y], &gradient, 1e-4, |p| field.sample(p[0], p[1]).0);
            for (at, &distance) in field.distance().iter().enumerate() {
                let (column, row) = (at % field.width, at / field.width);
                let sample = field.sample(column as f64 + 0.5, row as f64 + 0.5).0;
                prop_assert!((sample - distance).abs() < 1e-9);
            }
        }
    }
}
