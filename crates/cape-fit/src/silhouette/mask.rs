use std::path::Path;

use cape_render::Image;

use super::distance::manhattan;
use crate::{Error, PinholeCamera, Result, keypoints::KeypointDetection};

/// Largest distance of a joint on the mask, as a share of the longer side of the image.
const NEAR: f64 = 0.02;

/// Binary mask of the pixels that a person covers.
///
/// ```
/// use cape_fit::Mask;
///
/// // The left half and the upper half of an image.
/// let left = Mask::new(4, 4, (0..16).map(|pixel| pixel % 4 < 2).collect())?;
/// let upper = Mask::new(4, 4, (0..16).map(|pixel| pixel < 8).collect())?;
/// assert_eq!(left.area(), 8);
/// assert!((left.intersection_over_union(&upper)? - 4.0 / 12.0).abs() < 1e-12);
/// assert_eq!(left.resize(2, 2).covered(), [true, false, true, false]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mask {
    width: u32,
    height: u32,
    covered: Vec<bool>,
}

impl Mask {
    /// A mask of `width` × `height` pixels from flags, row by row, `[height · width]`.
    ///
    /// # Errors
    /// If the number of flags differs.
    pub fn new(width: u32, height: u32, covered: Vec<bool>) -> Result<Self> {
        if covered.len() != width as usize * height as usize {
            return Err(Error::Observation(format!(
                "mask: {} pixels, expected {width}×{height}",
                covered.len()
            )));
        }
        Ok(Self { width, height, covered })
    }

    /// Mask of an image: the opaque pixels if any pixel is transparent, else those of more than half
    /// the largest brightness, so that masks of 0 and 1 and of 0 and 255 are alike.
    pub fn from_image(image: &Image) -> Self {
        let cut_out = image.pixels().iter().any(|pixel| pixel[3] <= 127);
        let brightness = |&[r, g, b, _]: &[u8; 4]| u16::from(r.max(g).max(b));
        let most = image.pixels().iter().map(brightness).max().unwrap_or(0);
        let on =
            |pixel: &[u8; 4]| if cut_out { pixel[3] > 127 } else { 2 * brightness(pixel) > most };
        Self {
            width: image.width(),
            height: image.height(),
            covered: image.pixels().iter().map(on).collect(),
        }
    }

    /// Reads a mask from a PNG, as [`from_image`](Self::from_image) takes it.
    ///
    /// # Errors
    /// If the file is not a PNG.
    pub fn load(path: impl AsRef<Path>) -> Result<Self> {
        Ok(Self::from_image(&Image::load(path)?))
    }

    /// Image of the mask, white on black.
    ///
    /// # Errors
    /// If the mask is empty or too large for an image.
    pub fn to_image(&self) -> Result<Image> {
        let mut image = Image::new(self.width, self.height, [0, 0, 0, 255])?;
        for (pixel, &covered) in image.pixels_mut().iter_mut().zip(&self.covered) {
            if covered {
                *pixel = [255; 4];
            }
        }
        Ok(image)
    }

    /// Width, pixels.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height, pixels.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Flags of the covered pixels, row by row, `[height · width]`.
    pub fn covered(&self) -> &[bool] {
        &self.covered
    }

    /// Number of covered pixels.
    pub fn area(&self) -> usize {
        self.covered.iter().filter(|&&covered| covered).count()
    }

    /// Checks that the mask can be of a person in the image of a camera.
    ///
    /// # Errors
    /// If it has another size than the image, or covers nothing or everything.
    pub fn check(&self, camera: &PinholeCamera) -> Result<()> {
        let refuse = |message: String| Err(Error::Observation(message));
        if (self.width, self.height) != (camera.width(), camera.height()) {
            return refuse(format!(
                "mask: {}×{} pixels, expected the {}×{} of the image",
                self.width,
                self.height,
                camera.width(),
                camera.height()
            ));
        }
        match self.area() {
            0 => refuse("the mask is empty, expected the silhouette of a person".into()),
            area if area == self.covered.len() => refuse(
                "the mask covers the whole image, expected the silhouette of a person".into(),
            ),
            _ => Ok(()),
        }
    }

    /// An error if less than half of the detected joints are on the mask: it is of another size,
    /// image or person.
    pub(crate) fn expect_joints(&self, detections: &[KeypointDetection]) -> Result<()> {
        let (count, found) = (detections.len(), self.joints_on(detections));
        if 2 * found >= count {
            return Ok(());
        }
        let covered = self.covered.iter().map(|covered| !covered).collect();
        let inverse = Self { covered, ..*self };
        let reason =
            if 2 * self.area() > self.covered.len() && inverse.joints_on(detections) > found {
                "it seems to be inverted, with the person dark"
            } else {
                "it is of another size, another image or another person than the keypoints"
            };
        Err(Error::Observation(format!(
            "{found} of {count} joints are on the mask, expected at least half: {reason}"
        )))
    }

    /// Number of detections on the mask or beside it.
    fn joints_on(&self, detections: &[KeypointDetection]) -> usize {
        let nearest = manhattan(self);
        let near = NEAR * f64::from(self.width.max(self.height));
        let on = |s: &&KeypointDetection| nearest.sample(s.at.x, s.at.y).0 <= near;
        detections.iter().filter(on).count()
    }

    /// Share of the detections on the mask, 0 to 1.
    pub(crate) fn share_of(&self, detections: &[KeypointDetection]) -> f64 {
        self.joints_on(detections) as f64 / detections.len().max(1) as f64
    }

    /// The mask at another size: a pixel is covered if more than half of its area is.
    #[must_use]
    pub fn resize(&self, width: u32, height: u32) -> Self {
        if (width, height) == (self.width, self.height) {
            return self.clone();
        }
        let (columns, rows) = (shares(self.width, width), shares(self.height, height));
        let mut covered = Vec::with_capacity(width as usize * height as usize);
        for row in &rows {
            for column in &columns {
                let (mut inside, mut all) = (0.0, 0.0);
                for &(y, share_y) in row {
                    for &(x, share_x) in column {
                        let share = share_x * share_y;
                        all += share;
                        if self.covered[y * self.width as usize + x] {
                            inside += share;
                        }
                    }
                }
                covered.push(inside > 0.5 * all);
            }
        }
        Self { width, height, covered }
    }

    /// Intersection over union of two masks, 0 to 1; 1 if both are empty.
    ///
    /// # Errors
    /// If the sizes differ.
    pub fn intersection_over_union(&self, other: &Self) -> Result<f64> {
        if (self.width, self.height) != (other.width, other.height) {
            return Err(Error::argument(format!(
                "masks: {}×{} and {}×{} pixels, expected the same size",
                self.width, self.height, other.width, other.height
            )));
        }
        let pairs = || self.covered.iter().zip(&other.covered);
        let both = pairs().filter(|&(&a, &b)| a && b).count();
        let either = pairs().filter(|&(&a, &b)| a || b).count();
        Ok(if either == 0 { 1.0 } else { both as f64 / either as f64 })
    }
}

/// Overlapping cells of a grid of `from` cells, with the overlaps, for each cell of a grid of `to`
/// cells.
fn shares(from: u32, to: u32) -> Vec<Vec<(usize, f64)>> {
    let scale = f64::from(from) / f64::from(to);
    let cell = |at: u32| {
        let (start, end) = (f64::from(at) * scale, f64::from(at + 1) * scale);
        let cells = start as usize..(end.ceil() as usize).min(from as usize);
        cells.map(|i| (i, end.min(i as f64 + 1.0) - start.max(i as f64))).collect()
    };
    (0..to).map(cell).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Keypoint;

    fn disc(side: u32) -> Mask {
        let centre = 0.5 * f64::from(side);
        let covered = (0..side * side).map(|at| {
            let (x, y) = (f64::from(at % side) + 0.5, f64::from(at / side) + 0.5);
            (x - centre).hypot(y - centre) < 0.35 * f64::from(side)
        });
        Mask::new(side, side, covered.collect()).unwrap()
    }

    #[test]
    fn a_disc_stays_a_disc_at_any_size() {
        for side in [32, 50, 100] {
            let expected = disc(side);
            let overlap = disc(200).resize(side, side).intersection_over_union(&expected);
            assert!(overlap.unwrap() > 0.98);
        }
        assert_eq!(disc(64).resize(64, 64), disc(64));
        let wide = disc(30).resize(60, 15);
        assert_eq!((wide.width(), wide.height()), (60, 15));
    }

    #[test]
    fn pictures_and_masks_are_the_same() {
        let mask = disc(20);
        assert_eq!(Mask::from_image(&mask.to_image().unwrap()), mask);
        let shifted = Mask::new(2, 1, vec![true, false]).unwrap();
        let other = Mask::new(2, 1, vec![true, true]).unwrap();
        assert_eq!(shifted.intersection_over_union(&other).unwrap(), 0.5);
        assert!(shifted.intersection_over_union(&mask).is_err());
    }

    #[test]
    fn small_values_and_cut_outs_are_masks() {
        let mask = disc(20);
        let picture = |on: [u8; 4], off: [u8; 4]| {
            let mut image = Image::new(20, 20, off).unwrap();
            for (pixel, _) in image.pixels_mut().iter_mut().zip(mask.covered()).filter(|p| *p.1) {
                *pixel = on;
            }
            Mask::from_image(&image)
        };
        assert_eq!(picture([1, 1, 1, 255], [0, 0, 0, 255]), mask);
        // Dark clothes cut out of a photograph.
        assert_eq!(picture([30, 30, 60, 255], [0; 4]), mask);
        assert_eq!(picture([30, 30, 60, 255], [255, 255, 255, 0]), mask);
    }

    #[test]
    fn masks_off_the_joints_are_refused() {
        let mask = disc(100);
        let joints = |places: &[(f64, f64)]| -> Vec<KeypointDetection> {
            let at = |&(x, y): &(f64, f64)| Keypoint { x, y, confidence: 1.0 };
            places.iter().map(|p| KeypointDetection { joint: 0, at: at(p) }).collect()
        };
        assert!(mask.expect_joints(&joints(&[(50.0, 50.0), (50.0, 84.0), (2.0, 2.0)])).is_ok());
        let elsewhere = joints(&[(50.0, 50.0), (250.0, 84.0), (2.0, 2.0)]);
        let message = mask.expect_joints(&elsewhere).unwrap_err().to_string();
        assert!(message.contains("1 of 3 joints"), "{message}");
    }

    #[test]
    fn masks_without_silhouette_are_refused() {
        let camera = PinholeCamera::new(20, 20, None).unwrap();
        let message = |mask: Mask| mask.check(&camera).unwrap_err().to_string();
        assert!(disc(20).check(&camera).is_ok());
        assert!(message(disc(21)).contains("21×21"));
        assert!(message(Mask::new(20, 20, vec![false; 400]).unwrap()).contains("empty"));
        assert!(message(Mask::new(20, 20, vec![true; 400]).unwrap()).contains("whole"));
        assert!(Mask::new(20, 20, vec![true; 399]).is_err());
    }
}
