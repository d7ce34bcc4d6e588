//! Predictions without a network, that a regression must be better than.

use cape_stats::ridge::ridge;
use ndarray::{Array2, Axis, concatenate};
use serde::{Deserialize, Serialize};

use super::{Factor, LayerError, LearningOptions, TrainedModel, UnposedSet};
use crate::{
    Error, Result,
    regress::{FeatureOptions, RegressionInputs},
};

/// Weights of the squared coefficients of ridge regression, of which the best on the validation frames is
/// taken.
const WEIGHTS: [f64; 6] = [1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0];

/// Mean errors of simpler predictions on the held-out frames, millimetres.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct BaselineErrors {
    /// Mean of the training frames.
    pub mean_mm: f64,
    /// Training frame with the nearest pose.
    pub nearest_pose_mm: f64,
    /// Ridge regression from the inputs of the network.
    pub ridge_mm: f64,
    /// Interpolation in time between the training frames before and after, if they are of the same
    /// sequences.
    pub interpolation_mm: Option<f64>,
    /// Mean of the same moments of the same motion in the training sequences, if all have one.
    pub same_moment_mm: Option<f64>,
}

/// Frames of a training and held-out frames, as indices into a set.
pub(super) struct HeldOut<'a> {
    pub(super) known: &'a [usize],
    pub(super) held: &'a [usize],
    /// True if whole sequences are held out.
    pub(super) sequences: bool,
}

impl BaselineErrors {
    /// Measures the predictions of `held` frames from the training and validation frames of `model`.
    pub(super) fn measure(
        set: &UnposedSet<'_>,
        frames: &HeldOut<'_>,
        model: &TrainedModel,
        learning: &LearningOptions,
    ) -> Result<Self> {
        let of = |chosen: &[usize]| chosen.iter().map(|&k| frames.known[k]).collect::<Vec<_>>();
        let trained = of(&model.outcome.training_frames);
        let validated = of(&model.outcome.validation_frames);
        let measure = |offsets: &Array2<f64>| -> Result<f64> {
            Ok(LayerError::over(&set.errors(frames.held, offsets.view())?).mean)
        };
        let rows = |of: &[usize]| set.rows.select(Axis(0), of);
        let mean = model.pca.mean.view().insert_axis(Axis(0));
        let mean = mean.broadcast((frames.held.len(), set.rows.ncols())).map(|m| m.to_owned());
        let mean = mean.ok_or_else(|| Error::argument("mean of offsets of another length"))?;
        let inputs = set.inputs(&learning.features, &model.semantics)?;
        let ridge = ridge_codes(&inputs, [&trained, &validated, frames.held], set, model)?;
        let interpolated = interpolated(set, frames.known, frames.held);
        let same_moment = same_moment(set, frames.known, frames.held);
        Ok(Self {
            mean_mm: measure(&mean)?,
            nearest_pose_mm: measure(&rows(&nearest_poses(set, frames)?))?,
            ridge_mm: measure(&model.pca.decode(ridge.view())?)?,
            interpolation_mm: interpolated.as_ref().map(measure).transpose()?,
            same_moment_mm: same_moment.as_ref().map(measure).transpose()?,
        })
    }
}

/// Codes of the held-out frames by ridge regression from the bounded inputs.
fn ridge_codes(
    inputs: &RegressionInputs,
    [trained, validated, held]: [&[usize]; 3],
    set: &UnposedSet<'_>,
    model: &TrainedModel,
) -> Result<Array2<f64>> {
    let scaled = |frames: &[usize]| {
        model.outcome.regressor.scaled_inputs(inputs.rows.select(Axis(0), frames).view())
    };
    let codes = |frames: &[usize]| model.pca.encode(set.rows.select(Axis(0), frames).view());
    let [x, validated_x, held_x] = [trained, validated, held].map(scaled);
    let [y, validated_y] = [codes(trained)?, codes(validated)?];
    let mut best = (f64::INFINITY, WEIGHTS[0]);
    for weight in WEIGHTS {
        let off = ridge(x.view(), y.view(), validated_x.view(), weight)? - &validated_y;
        let error = off.iter().map(|x| x * x).sum::<f64>();
        if error < best.0 {
            best = (error, weight);
        }
    }
    let all_x = concatenate(Axis(0), &[x.view(), validated_x.view()]);
    let all_y = concatenate(Axis(0), &[y.view(), validated_y.view()]);
    let (Ok(x), Ok(y)) = (all_x, all_y) else {
        return Err(Error::argument("ridge regression: inputs of different widths"));
    };
    Ok(ridge(x.view(), y.view(), held_x.view(), best.1)?)
}

/// The known frame with the nearest joint angles for each held-out frame.
fn nearest_poses(set: &UnposedSet<'_>, frames: &HeldOut<'_>) -> Result<Vec<usize>> {
    let angles = FeatureOptions {
        speed: false,
        angular_speeds: false,
        history: 0,
        ..FeatureOptions::default()
    };
    let rows = set.motion_rows(&angles)?;
    let nearest = |&held: &usize| {
        let off = |known: usize| {
            let gap = &rows.row(known) - &rows.row(held);
            gap.dot(&gap)
        };
        frames.known.iter().copied().min_by(|&a, &b| off(a).total_cmp(&off(b)))
    };
    let found: Option<Vec<usize>> = frames.held.iter().map(nearest).collect();
    found.ok_or_else(|| Error::argument("nearest pose: no training frames"))
}

/// Offsets between those of the nearest known frames before and after in the same sequence; those of the
/// only neighbour at the ends. `None` if a sequence has no known frames.
fn interpolated(set: &UnposedSet<'_>, known: &[usize], held: &[usize]) -> Option<Array2<f64>> {
    let each = set.set().each_frame();
    let mut is_known = vec![false; each.len()];
    for &frame in known {
        is_known[frame] = true;
    }
    let mut rows = Array2::zeros((held.len(), set.rows.ncols()));
    for (&frame, mut row) in held.iter().zip(rows.rows_mut()) {
        let same = |&other: &usize| each[other].0 == each[frame].0;
        let before = (0..frame).rev().take_while(same).find(|&f| is_known[f]);
        let after = (frame + 1..each.len()).take_while(same).find(|&f| is_known[f]);
        let (a, b) = (before.or(after)?, after.or(before)?);
        let share = if a == b { 0.0 } else { (frame - a) as f64 / (b - a) as f64 };
        row.scaled_add(1.0 - share, &set.rows.row(a));
        row.scaled_add(share, &set.rows.row(b));
    }
    Some(rows)
}

/// Mean offsets of the known frames with the same number in sequences of the same motion; `None` if there
/// are none for a frame.
fn same_moment(set: &UnposedSet<'_>, known: &[usize], held: &[usize]) -> Option<Array2<f64>> {
    let each = set.set().each_frame();
    let mut motion = vec![0; set.set().sequences.len()];
    for (number, group) in Factor::Motion.groups(set.set()).iter().enumerate() {
        for &sequence in &group.sequences {
            motion[sequence] = number;
        }
    }
    let moment = |frame: usize| (motion[each[frame].0], each[frame].1);
    let mut rows = Array2::zeros((held.len(), set.rows.ncols()));
    for (&frame, mut row) in held.iter().zip(rows.rows_mut()) {
        let other = |&&k: &&usize| moment(k) == moment(frame) && each[k].0 != each[frame].0;
        let same: Vec<usize> = known.iter().filter(other).copied().collect();
        if same.is_empty() {
            return None;
        }
        for &k in &same {
            row.scaled_add(1.0 / same.len() as f64, &set.rows.row(k));
        }
    }
    Some(rows)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::tests::march;

    #[test]
    fn interpolation_lies_between_neighbours() {
        let model = cape_synth::synthetic_body();
        let (set, association) = march(&model);
        let standard = cape_core::smpl::StandardPose::default();
        let unposed = UnposedSet::new(&model, &set, &association, &standard).unwrap();
        let known: Vec<usize> = (0..60).filter(|f| ![0, 7, 8].contains(f)).collect();
        let rows = interpolated(&unposed, &known, &[0, 7, 8]).unwrap();
        let row = |frame: usize| unposed.rows.row(frame).to_owned();
        let near = |a: ndarray::ArrayView1<'_, f64>, b: ndarray::Array1<f64>| {
            (&a - &b).iter().all(|gap| gap.abs() < 1e-12)
        };
        assert!(near(rows.row(0), row(1)));
        assert!(near(rows.row(1), row(6) * (2.0 / 3.0) + row(9) / 3.0));
        assert!(near(rows.row(2), row(6) / 3.0 + row(9) * (2.0 / 3.0)));
        assert!(interpolated(&unposed, &[], &[3]).is_none());
        assert!(same_moment(&unposed, &known, &[7]).is_none(), "only one sequence");
        // A frame is nearest to itself.
        let frames = HeldOut { known: &[3, 7, 20], held: &[7, 20], sequences: false };
        assert_eq!(nearest_poses(&unposed, &frames).unwrap(), [7, 20]);
    }
}
