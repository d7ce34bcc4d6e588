//! Keypoints of a person in an image, and keypoint files of detectors.

mod dialect;
mod file;
#[cfg(test)]
mod input_tests;
mod json;
mod layout;
mod plausibility;

pub use file::{KeypointOptions, People, Person, read_keypoints, read_keypoints_with};
pub use layout::KeypointLayout;

pub(crate) use json::read_json;

use crate::{Error, Result};

/// A detected keypoint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Keypoint {
    /// Column, pixels from the left edge.
    pub x: f64,
    /// Row, pixels from the upper edge.
    pub y: f64,
    /// Confidence of the detector, 0 (not detected) to 1.
    pub confidence: f64,
}

impl Keypoint {
    /// A point that is not detected.
    pub const UNSEEN: Self = Self { x: 0.0, y: 0.0, confidence: 0.0 };

    /// The point with a confidence of at most 1; [`UNSEEN`](Self::UNSEEN) without finite numbers or
    /// a confidence above 0.
    fn cleaned(self) -> Self {
        let Self { x, y, confidence } = self;
        if x.is_finite() && y.is_finite() && confidence > 0.0 {
            Self { confidence: confidence.min(1.0), ..self }
        } else {
            Self::UNSEEN
        }
    }
}

/// Keypoints of one person.
///
/// ```
/// use cape_fit::{KeypointLayout, Keypoint, Keypoints};
///
/// // Only the point between the hips is detected.
/// let mut points = vec![Keypoint { x: 0.0, y: 0.0, confidence: 0.0 }; 25];
/// points[8] = Keypoint { x: 100.0, y: 200.0, confidence: 0.9 };
/// let keypoints = Keypoints::new(KeypointLayout::Body25, points)?;
/// let detections = keypoints.detections(0.5);
/// assert_eq!((detections.len(), detections[0].joint, detections[0].at.x), (1, 0, 100.0));
/// // The same in an image of half the size.
/// assert_eq!(keypoints.scaled(0.5).points()[8].y, 100.0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Keypoints {
    layout: KeypointLayout,
    points: Vec<Keypoint>,
}

/// Detection of a joint of SMPL.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KeypointDetection {
    /// Index of the joint.
    pub joint: usize,
    /// Keypoint of the joint.
    pub at: Keypoint,
}

impl Keypoints {
    /// Keypoints in the order of `layout`; confidences above 1 are clamped to 1. Points without
    /// finite numbers or with a confidence of 0 or less are not detected.
    ///
    /// # Errors
    /// If the number of points differs from the layout's.
    pub fn new(layout: KeypointLayout, points: Vec<Keypoint>) -> Result<Self> {
        let (found, expected) = (points.len(), layout.points());
        if found != expected {
            return Err(Error::Observation(format!(
                "{found} keypoints, expected the {expected} of {layout}"
            )));
        }
        Ok(Self { layout, points: points.into_iter().map(Keypoint::cleaned).collect() })
    }

    /// Layout of the points.
    pub fn layout(&self) -> KeypointLayout {
        self.layout
    }

    /// All points, including those that are not detected.
    pub fn points(&self) -> &[Keypoint] {
        &self.points
    }

    /// JSON of OpenPose with one person: x, y and confidence of each point.
    pub fn to_openpose(&self) -> serde_json::Value {
        let numbers: Vec<f64> = self.points.iter().flat_map(|p| [p.x, p.y, p.confidence]).collect();
        serde_json::json!({ "version": 1.3, "people": [{ "pose_keypoints_2d": numbers }] })
    }

    /// The same keypoints in an image scaled by `scale`.
    #[must_use]
    pub fn scaled(&self, scale: f64) -> Self {
        let scaled = |p: &Keypoint| Keypoint { x: p.x * scale, y: p.y * scale, ..*p };
        Self { layout: self.layout, points: self.points.iter().map(scaled).collect() }
    }

    /// Detections of SMPL joints with at least the confidence `confidence`, and above 0.
    pub fn detections(&self, confidence: f64) -> Vec<KeypointDetection> {
        let table = self.layout.joints().iter();
        let seen = table.map(|&(point, joint)| KeypointDetection { joint, at: self.points[point] });
        seen.filter(|s| s.at.confidence > 0.0 && s.at.confidence >= confidence).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn detections_have_enough_confidence() {
        let mut points = vec![Keypoint { x: 1.0, y: 2.0, confidence: 0.0 }; 25];
        points[4] = Keypoint { x: 5.0, y: 6.0, confidence: 1.2 };
        points[7].confidence = 0.3;
        points[0].confidence = 1.0;
        let keypoints = Keypoints::new(KeypointLayout::Body25, points.clone()).unwrap();
        let joints = |confidence: f64| -> Vec<usize> {
            keypoints.detections(confidence).iter().map(|s| s.joint).collect()
        };
        assert_eq!(joints(0.0), [21, 20]);
        assert_eq!(joints(0.5), [21]);
        assert_eq!(keypoints.detections(0.5)[0].at.confidence, 1.0);
        assert!(Keypoints::new(KeypointLayout::Coco17, points.clone()).is_err());
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("person.json");
        std::fs::write(&path, keypoints.to_openpose().to_string()).unwrap();
        assert_eq!(read_keypoints(&path).unwrap().choose(None).unwrap(), keypoints);
        assert_eq!(keypoints.scaled(2.0).points()[4].y, 12.0);
        for wrong in [f64::NAN, -0.1] {
            points[4].confidence = wrong;
            let keypoints = Keypoints::new(KeypointLayout::Body25, points.clone()).unwrap();
            assert_eq!(keypoints.points()[4], Keypoint::UNSEEN);
        }
    }
}
