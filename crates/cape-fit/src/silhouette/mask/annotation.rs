//! Masks of people in annotation files.

use std::path::Path;

use super::{Mask, segmentation::is_run_lengths, values::refuse};
use crate::{
    Error, KeypointOptions, Keypoints, Result,
    keypoints::{read_json, read_keypoints_with},
};

/// True for the path of an annotation file (JSON), which [`read_annotated_mask`] reads, instead of an
/// image of a mask.
pub fn is_annotation(path: impl AsRef<Path>) -> bool {
    path.as_ref().extension().is_some_and(|extension| extension.eq_ignore_ascii_case("json"))
}

/// Reads the mask of a person from COCO's annotations: of the outlines (`segmentation`) of the image
/// that `options` tell, the one that most of the person's joints are on; the smallest of several.
/// The file can also hold one outline of run lengths alone.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use cape_fit::{KeypointOptions, PinholeCamera, silhouette::read_annotated_mask};
///
/// // Outlines of a strip at the left and of what is right of it, where the person is.
/// let camera = PinholeCamera::new(512, 512, None)?;
/// let (_, keypoints) = seen(&cape_synth::synthetic_body(), &camera)?;
/// let outline = |x: f64| serde_json::json!({
///     "image_id": 1, "segmentation": [[x, 0, x + 500.0, 0, x + 500.0, 512, x, 512]]
/// });
/// let directory = tempfile::tempdir()?;
/// let path = directory.path().join("annotations.json");
/// let file = serde_json::json!({ "annotations": [outline(-490.0), outline(10.0)] });
/// std::fs::write(&path, file.to_string())?;
/// let options = KeypointOptions { size: Some([512, 512]), ..KeypointOptions::default() };
/// let mask = read_annotated_mask(&path, &keypoints, &options)?;
/// assert_eq!(mask.area(), 500 * 512);
/// # Ok(())
/// # }
/// ```
///
/// # Errors
/// If the file has no outline of the image, or none that half of the joints are on.
pub fn read_annotated_mask(
    path: impl AsRef<Path>,
    keypoints: &Keypoints,
    options: &KeypointOptions,
) -> Result<Mask> {
    let path = path.as_ref();
    let json = read_json(path)?;
    if is_run_lengths(&json) {
        return Mask::from_segmentation(&json, options.size);
    }
    let people = read_keypoints_with(path, options)?;
    let size = options.size.or(people.size());
    let outlines = || people.all().iter().filter_map(|person| person.segmentation.as_ref());
    if outlines().next().is_none() {
        return Err(Error::format(path, "no `segmentation`, expected COCO's annotations"));
    }
    let joints = keypoints.detections(0.0);
    let (mut best, mut reason): (Option<(f64, Mask)>, _) = (None, None);
    for outline in outlines() {
        match Mask::from_segmentation(outline, size) {
            Ok(mask) => {
                let share = mask.share_of(&joints);
                let better = best.as_ref().is_none_or(|(most, other)| {
                    share > *most || (share == *most && mask.area() < other.area())
                });
                if better {
                    best = Some((share, mask));
                }
            }
            Err(error) => reason = Some(error),
        }
    }
    match (best, reason) {
        (Some((share, mask)), _) if share >= 0.5 => Ok(mask),
        (None, Some(error)) => Err(Error::format(path, error.to_string())),
        _ => refuse(format!(
            "{}: none of {} outlines has at least half of the person's joints",
            path.display(),
            outlines().count()
        )),
    }
}
