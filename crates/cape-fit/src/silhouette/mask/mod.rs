//! Masks of people, and the files that hold them.

mod annotation;
mod file;
#[cfg(test)]
mod file_tests;
mod segmentation;
mod values;

use std::path::Path;

use cape_render::Image;

use super::distance::manhattan;
use crate::{Error, Keypoints, PinholeCamera, Result, keypoints::KeypointDetection};

pub use annotation::{is_annotation, read_annotated_mask};
pub use values::MaskLabel;

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

    /// [`load_labels`](Self::load_labels) without labels.
    ///
    /// # Errors
    /// As of [`load_labels`](Self::load_labels).
    pub fn load(path: impl AsRef<Path>) -> Result<Self> {
        Self::load_labels(path, &[])
    }

    /// Reads a mask from PNG of any colour type and depth, JPEG, `.npy` or `.npz` (`[h, w]` or
    /// `[1, h, w]`).
    ///
    /// With `labels` the pixels of one of these values or colours are the mask. Without: in images
    /// with transparent pixels the opaque ones; of an image of two values the brighter one; of an
    /// image of nearly black and nearly white pixels those above half of the largest value.
    ///
    /// # Errors
    /// If the file cannot be read, or is a photograph, or a label image without `labels`; the
    /// message lists the labels.
    pub fn load_labels(path: impl AsRef<Path>, labels: &[MaskLabel]) -> Result<Self> {
        file::read_mask(path.as_ref(), labels)
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

    /// Width and height, pixels.
    pub fn size(&self) -> [u32; 2] {
        [self.width, self.height]
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
            0 => refuse(
                "the mask is empty: all pixels are black, expected the silhouette of a person".into(),
            ),
            area if area == self.covered.len() => refuse(
                "the mask covers the whole image: all pixels are white, expected the silhouette of a \
                 person"
                    .into(),
            ),
            _ => Ok(()),
        }
    }

    /// Checks that the mask can be of the person of the keypoints: at least a quarter of the detected
    /// joints are in the image, and at least half of those that `occluders` do not hide are on it.
    ///
    /// # Errors
    /// If it is of another size, image or person, or inverted.
    pub fn check_keypoints(&self, keypoints: &Keypoints, occluders: Option<&Self>) -> Result<()> {
        self.expect_joints(&keypoints.detections(0.0), occluders)
    }

    /// [`check_keypoints`](Self::check_keypoints) of detected joints.
    pub(crate) fn expect_joints(
        &self,
        detections: &[KeypointDetection],
        occluders: Option<&Self>,
    ) -> Result<()> {
        let visible = |s: &&KeypointDetection| occluders.and_then(|o| o.at(s)) != Some(true);
        let all = detections.len();
        let detections: Vec<KeypointDetection> =
            detections.iter().filter(visible).copied().collect();
        let hidden = all - detections.len();
        let in_image: Vec<KeypointDetection> =
            detections.iter().filter(|s| self.at(s).is_some()).copied().collect();
        let (count, found) = (in_image.len(), self.joints_on(&in_image));
        if 4 * (count + hidden) >= all && 2 * found >= count {
            return Ok(());
        }
        let reach = |of: fn(&KeypointDetection) -> f64| {
            detections.iter().map(of).fold(f64::NEG_INFINITY, f64::max)
        };
        let (right, low) = (reach(|s| s.at.x), reach(|s| s.at.y));
        if right > f64::from(self.width) || low > f64::from(self.height) {
            return Err(Error::Observation(format!(
                "{found} of {count} joints are on the mask, expected at least half: the keypoints \
                 reach to ({right:.0}, {low:.0}), beyond the {}×{} pixels of the mask, which is of \
                 another size",
                self.width, self.height
            )));
        }
        let covered = self.covered.iter().map(|covered| !covered).collect();
        let inverse = Self { covered, ..*self };
        let reason = if 2 * self.area() > self.covered.len() && inverse.joints_on(&in_image) > found
        {
            "it seems to be inverted, with the person dark"
        } else {
            "it is of another size, another image or another person than the keypoints"
        };
        Err(Error::Observation(format!(
            "{found} of {count} joints are on the mask, expected at least half: {reason}"
        )))
    }

    /// Flag of the pixel that a detection is in; `None` outside the image.
    fn at(&self, detection: &KeypointDetection) -> Option<bool> {
        let index = |at: f64, side: u32| (at >= 0.0 && at < f64::from(side)).then_some(at as usize);
        let (x, y) = (index(detection.at.x, self.width)?, index(detection.at.y, self.height)?);
        Some(self.covered[y * self.width as usize + x])
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

    /// Pixels of this mask or the other, of the same size.
    ///
    /// # Errors
    /// If the sizes differ.
    pub fn union(&self, other: &Self) -> Result<Self> {
        self.combine(other, |a, b| a || b)
    }

    /// Pixels of this mask that are not of the other, of the same size.
    ///
    /// # Errors
    /// If the sizes differ.
    pub fn without(&self, other: &Self) -> Result<Self> {
        self.combine(other, |a, b| a && !b)
    }

    fn combine(&self, other: &Self, of: fn(bool, bool) -> bool) -> Result<Self> {
        self.same_size(other)?;
        let pairs = self.covered.iter().zip(&other.covered);
        Ok(Self { covered: pairs.map(|(&a, &b)| of(a, b)).collect(), ..*self })
    }

    fn same_size(&self, other: &Self) -> Result<()> {
        if (self.width, self.height) == (other.width, other.height) {
            return Ok(());
        }
        Err(Error::argument(format!(
            "masks: {}×{} and {}×{} pixels, expected the same size",
            self.width, self.height, other.width, other.height
        )))
    }

    /// Intersection over union of two masks, 0 to 1; 1 if both are empty.
    ///
    /// # Errors
    /// If the sizes differ.
    pub fn intersection_over_union(&self, other: &Self) -> Result<f64> {
        self.same_size(other)?;
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

    fn place() -> (tempfile::TempDir, std::path::PathBuf) {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("mask.png");
        (directory, path)
    }

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
        let (directory, path) = place();
        mask.to_image().unwrap().save(&path).unwrap();
        assert_eq!(Mask::load(&path).unwrap(), mask);
        drop(directory);
        let shifted = Mask::new(2, 1, vec![true, false]).unwrap();
        let other = Mask::new(2, 1, vec![true, true]).unwrap();
        assert_eq!(shifted.intersection_over_union(&other).unwrap(), 0.5);
        assert!(shifted.intersection_over_union(&mask).is_err());
        assert_eq!(other.without(&shifted).unwrap().covered(), [false, true]);
        assert_eq!(other.without(&shifted).unwrap().union(&shifted).unwrap(), other);
        assert!(shifted.union(&mask).is_err());
    }

    #[test]
    fn masks_off_the_joints_are_refused() {
        let mask = disc(100);
        let joints = |places: &[(f64, f64)]| -> Vec<KeypointDetection> {
            let at = |&(x, y): &(f64, f64)| Keypoint { x, y, confidence: 1.0 };
            places.iter().map(|p| KeypointDetection { joint: 0, at: at(p) }).collect()
        };
        assert!(
            mask.expect_joints(&joints(&[(50.0, 50.0), (50.0, 84.0), (2.0, 2.0)]), None).is_ok()
        );
        let elsewhere = joints(&[(50.0, 50.0), (98.0, 97.0), (2.0, 2.0)]);
        let message = mask.expect_joints(&elsewhere, None).unwrap_err().to_string();
        assert!(message.contains("1 of 3 joints"), "{message}");
        // Joints that are hidden, or outside the image of a person cut off, count neither way.
        let corner = Mask::new(100, 100, (0..10000).map(|at| at % 100 < 5).collect()).unwrap();
        let hidden = joints(&[(50.0, 50.0), (2.0, 9.0), (2.0, 2.0), (50.0, 104.0)]);
        assert!(mask.expect_joints(&hidden, Some(&corner)).is_ok());
        assert!(mask.expect_joints(&hidden, None).is_err());
        let larger =
            joints(&[(50.0, 50.0), (250.0, 184.0), (200.0, 2.0), (150.0, 20.0), (180.0, 90.0)]);
        let message = mask.expect_joints(&larger, None).unwrap_err().to_string();
        assert!(message.contains("(250, 184), beyond the 100×100"), "{message}");
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
