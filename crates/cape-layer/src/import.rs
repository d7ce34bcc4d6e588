//! Sequences from captures and other simulators.

use cape_core::{BodyMotion, MeshSequence};
use ndarray::{Axis, s};

use crate::{Error, Result, Sequence};

/// Rates of the files of a sequence, frames per second.
///
/// ```
/// use cape_layer::ImportRates;
///
/// // Meshes at 60 frames per second of a motion at 120: the motion is resampled.
/// let rates = ImportRates { meshes: Some(60.0), output: None };
/// assert_ne!(rates, ImportRates::default());
/// ```
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ImportRates {
    /// Rate of the meshes; without it, that which their file says, or that of the motion.
    pub meshes: Option<f64>,
    /// Rate of the imported sequence; without it, that of the meshes.
    pub output: Option<f64>,
}

/// Sequence of captured or simulated meshes on a body, in metres with y up, without semantic
/// parameters. Where the rates of meshes and motion differ, both are resampled to that of the output.
///
/// # Errors
/// If the numbers of frames do not agree, or rates are not positive.
pub fn import(
    name: &str,
    meshes: &MeshSequence,
    motion: &BodyMotion,
    betas: Vec<f64>,
    rates: ImportRates,
) -> Result<Sequence> {
    let of_meshes = rates.meshes.or(meshes.frame_rate).unwrap_or(motion.frame_rate);
    let output = rates.output.unwrap_or(of_meshes);
    let same = |a: f64, b: f64| (a - b).abs() <= 1e-6 * a.max(b);
    let (found, of_body) = (meshes.frames(), motion.frames());
    let spans = (found as f64 / of_meshes, of_body as f64 / motion.frame_rate);
    // The last frames may lie a frame of the slower rate apart.
    let slack = 1.0 / of_meshes.min(motion.frame_rate) + 1e-9;
    let agree = if same(of_meshes, motion.frame_rate) {
        found == of_body
    } else {
        (spans.0 - spans.1).abs() <= slack
    };
    if !agree {
        return Err(Error::sequence(
            name,
            format!(
                "{found} frames of clothing at {of_meshes} frames per second, but {of_body} of the body at \
                 {}: clothing and body are out of step; give the rates of both if they differ",
                motion.frame_rate
            ),
        ));
    }
    let meshes = meshes.resampled(of_meshes, output)?;
    let mut motion = motion.resampled(output)?;
    let frames = meshes.frames().min(motion.frames());
    let clothing = meshes.positions.slice_axis(Axis(0), (0..frames).into()).to_owned();
    motion.poses = motion.poses.slice(s![..frames, ..]).to_owned();
    motion.translations = motion.translations.slice(s![..frames, ..]).to_owned();
    let vertices = clothing.len_of(Axis(1));
    let sequence =
        Sequence { name: name.to_owned(), clothing, betas, motion, parameters: Vec::new() };
    sequence.check(vertices)?;
    Ok(sequence)
}

#[cfg(test)]
mod tests {
    use ndarray::{Array2, Array3};

    use super::*;

    /// Clothing and body that rise by 1 m a second.
    fn rising(frames: usize, rate: f64) -> (MeshSequence, BodyMotion) {
        let at = |frame: usize| frame as f64 / rate;
        let positions = Array3::from_shape_fn((frames, 3, 3), |(f, v, k)| match k {
            1 => at(f),
            _ => (v + k) as f64,
        });
        let translations =
            Array2::from_shape_fn((frames, 3), |(f, k)| if k == 1 { at(f) } else { 0.0 });
        let motion = BodyMotion::new(rate, Array2::zeros((frames, 72)), translations).unwrap();
        (MeshSequence { faces: vec![[0, 1, 2]], positions, frame_rate: None }, motion)
    }

    #[test]
    fn clothing_and_body_stay_together_at_any_rate() {
        let (meshes, _) = rising(13, 30.0);
        let (same, slow) = (rising(13, 30.0).1, rising(6, 12.0).1);
        let fast = rising(49, 120.0).1;
        for (motion, meshes_rate, output, frames) in [
            (&same, None, None, 13),
            (&fast, Some(30.0), None, 13),
            (&slow, Some(30.0), None, 13),
            (&same, None, Some(60.0), 25),
            (&fast, Some(30.0), Some(10.0), 5),
        ] {
            let rates = ImportRates { meshes: meshes_rate, output };
            let found = import("a", &meshes, motion, vec![], rates).unwrap();
            assert_eq!(found.frames(), frames);
            assert_eq!(found.motion.frame_rate, output.unwrap_or(30.0));
            for frame in 0..frames {
                let time = frame as f64 / found.motion.frame_rate;
                let (cloth, body) =
                    (found.clothing[(frame, 0, 1)], found.motion.translation(frame)[1]);
                assert!((cloth - time).abs() < 1e-9 && (body - time).abs() < 1e-9, "{frame}");
            }
        }
        // The rate in the meshes' file counts without another.
        let known = MeshSequence { frame_rate: Some(30.0), ..meshes.clone() };
        assert_eq!(
            import("a", &known, &fast, vec![], ImportRates::default()).unwrap().frames(),
            13
        );
        let message = import("a", &meshes, &fast, vec![], ImportRates::default()).unwrap_err();
        assert!(message.to_string().contains("13 frames of clothing at 120"), "{message}");
    }
}
