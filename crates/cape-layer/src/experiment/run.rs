use ndarray::{Array1, Array2, Axis, s};
use serde::{Deserialize, Serialize};

use super::{
    BaselineErrors, ComponentCurve, Factor, LayerError, LearningOptions, ONE, PushedOut,
    RegressionReport, UnposedSet,
};
use crate::{ComponentSelection, Error, LayerSet, Pca, Result};

/// Positions of the example frames in a held-out group, as shares of its length.
const EXAMPLES: [f64; 3] = [0.2, 0.5, 0.8];

/// An experiment of the paper on a set.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use cape_core::smpl::StandardPose;
/// use cape_layer::experiment::{Experiment, LearningOptions, UnposedSet};
/// use cape_synth::synthetic_body;
///
/// // One sequence allows tables 1 and 2; more allow leaving out what they differ in.
/// let body = synthetic_body();
/// let (set, association) = patch(&body)?;
/// assert_eq!(Experiment::for_set(&set), [Experiment::Reconstruction, Experiment::Regression]);
/// let unposed = UnposedSet::new(&body, &set, &association, &StandardPose::default())?;
/// let options = LearningOptions { components: Some(1), ..LearningOptions::default() };
/// let outcome = Experiment::Reconstruction.run("patch", &unposed, &options, &mut |_, _| {})?;
/// assert_eq!(outcome.results.reconstructed[0].components, [1, 5]);
/// assert!(outcome.results.reconstructed[0].errors_mm[0] < 1e-6);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Experiment {
    /// Reconstruction by principal components (table 1).
    Reconstruction,
    /// Regression of held-out frames (table 2).
    Regression,
    /// Prediction of each held-out value of a factor (§5.1–5.3).
    Transfer(Factor),
}

/// Errors of the reconstruction of one sequence (a row of table 1), millimetres.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ReconstructionResult {
    /// Name of the set.
    pub set: String,
    /// Name of the sequence.
    pub sequence: String,
    /// Number of frames.
    pub frames: usize,
    /// Numbers of components, ascending.
    pub components: Vec<usize>,
    /// Mean error with each number of components, and with all last, `[components + 1]`.
    pub errors_mm: Vec<f64>,
    /// Largest error with all components.
    pub largest_mm: f64,
}

/// Errors of one regression (a row of table 2, or of a transfer), millimetres.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RegressionResult {
    /// Name of the set.
    pub set: String,
    /// Name of the held-out factor; empty for held-out frames.
    pub factor: String,
    /// Name of the sequence, or held-out value of the factor.
    pub name: String,
    /// Number of training frames.
    pub trained: usize,
    /// Number of predicted frames.
    pub frames: usize,
    /// Mean error on the training frames, `E_train`, over the trainings.
    pub train_mm: f64,
    /// Mean error on the predicted frames, `E_pred`, over the trainings.
    pub predict_mm: f64,
    /// Mean error on the predicted frames over the whole dressed surface, clothing and bare skin, whose error
    /// is 0 because the body is known.
    pub dressed_mm: f64,
    /// Mean error on the predicted frames of each training.
    pub predict_each_mm: Vec<f64>,
    /// Largest error on the predicted frames.
    pub largest_mm: f64,
    /// Mean error of the predicted frames' own coordinates in the components.
    pub space_mm: f64,
    /// Mean errors of simpler predictions.
    pub baselines: BaselineErrors,
    /// Measures of the prediction of the first training pushed out of the body.
    pub pushed_out: PushedOut,
    /// Number of iterations of the first training.
    pub iterations: usize,
}

impl RegressionResult {
    /// Standard deviation of the mean error over the trainings, millimetres; `None` with fewer than two.
    pub fn predict_deviation_mm(&self) -> Option<f64> {
        let each = Array1::from_vec(self.predict_each_mm.clone());
        (each.len() > 1).then(|| each.std(1.0))
    }
}

/// Result rows of an experiment.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct ExperimentResults {
    /// Rows of table 1.
    pub reconstructed: Vec<ReconstructionResult>,
    /// Rows of table 2 or of a transfer.
    pub regressed: Vec<RegressionResult>,
    /// Error by the number of components (figure 3).
    pub curves: Vec<ComponentCurve>,
}

/// Clothing of an example frame, for pictures.
#[derive(Debug, Clone, PartialEq)]
pub struct ExampleFrame {
    /// Caption.
    pub label: String,
    /// Index of the frame in the set.
    pub frame: usize,
    /// Reconstructed or predicted clothing, metres, `[n_v, 3]`; `None` for the ground truth.
    pub clothing: Option<Array2<f64>>,
}

/// Result rows of an experiment, with examples.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ExperimentOutcome {
    /// Result rows.
    pub results: ExperimentResults,
    /// Example frames: ground truth, each followed by its reconstructions or its prediction.
    pub examples: Vec<ExampleFrame>,
}

impl Experiment {
    /// Experiments that a set allows: transfers need sequences that differ in the factor.
    pub fn for_set(set: &LayerSet) -> Vec<Self> {
        let transfers = Factor::ALL.into_iter().filter(|factor| factor.groups(set).len() > 1);
        [Self::Reconstruction, Self::Regression]
            .into_iter()
            .chain(transfers.map(Self::Transfer))
            .collect()
    }

    /// Name in tables and files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Reconstruction => "reconstruction",
            Self::Regression => "regression",
            Self::Transfer(factor) => factor.name(),
        }
    }

    /// Runs the experiment on a set with the name `name`. `progress` is called with the number of
    /// finished trainings and of all.
    ///
    /// # Errors
    /// If the set has too few frames for the components, or an option is out of range.
    pub fn run(
        self,
        name: &str,
        unposed: &UnposedSet<'_>,
        options: &LearningOptions,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<ExperimentOutcome> {
        let run = ExperimentRun { name, unposed, options };
        match self {
            Self::Reconstruction => run.reconstruction(progress),
            Self::Regression => run.regression(progress),
            Self::Transfer(factor) => run.transfer(factor, progress),
        }
    }
}

impl ExampleFrame {
    /// The ground truth of a frame, labelled by its motion and its number in the sequence.
    fn truth(set: &LayerSet, frame: usize) -> Self {
        let (sequence, number) = set.each_frame()[frame];
        let name = &set.sequences[sequence].name;
        let motion = name.rsplit_once('_').map_or(name.as_str(), |(_, last)| last);
        Self { label: format!("{motion}, frame {number}"), frame, clothing: None }
    }
}

struct ExperimentRun<'a> {
    name: &'a str,
    unposed: &'a UnposedSet<'a>,
    options: &'a LearningOptions,
}

impl ExperimentRun<'_> {
    fn reconstruction(&self, progress: &mut dyn FnMut(usize, usize)) -> Result<ExperimentOutcome> {
        let mut counts = vec![1, 5, self.options.components.unwrap_or(ONE)];
        counts.sort_unstable();
        counts.dedup();
        let sequences = &self.unposed.set().sequences;
        let mut reconstructed = Vec::new();
        for (index, sequence) in sequences.iter().enumerate() {
            let errors = self.unposed.reconstruction_of(index, &counts)?;
            let all = errors.last().copied().unwrap_or(LayerError::over(&[]));
            reconstructed.push(ReconstructionResult {
                set: self.name.to_owned(),
                sequence: sequence.name.clone(),
                frames: sequence.frames(),
                components: counts.clone(),
                errors_mm: errors.iter().map(|error| error.mean).collect(),
                largest_mm: all.largest,
            });
            progress(index + 1, 2 * sequences.len());
        }
        let curve = ComponentCurve::measure(self.name, self.unposed, &mut |done| {
            progress(sequences.len() + done, 2 * sequences.len());
        })?;
        let curves = vec![curve];
        let results = ExperimentResults { reconstructed, curves, ..ExperimentResults::default() };
        Ok(ExperimentOutcome { results, examples: self.reconstruction_examples(&counts)? })
    }

    /// The middle frame of the first sequence, reconstructed by its own components.
    fn reconstruction_examples(&self, counts: &[usize]) -> Result<Vec<ExampleFrame>> {
        let (frames, _) = self.unposed.frames_of(&[0]);
        let rows = self.unposed.rows.select(Axis(0), &frames);
        let all = Pca::from_snapshots(rows.view(), ComponentSelection::All)?;
        let middle = frames.len() / 2;
        let (frame, row) = (frames[middle], rows.slice(s![middle..=middle, ..]));
        let mut examples = vec![ExampleFrame::truth(self.unposed.set(), frame)];
        for &count in counts {
            let pca = all.truncated(count);
            let offsets = pca.decode(pca.encode(row)?.view())?;
            let clothing = self.unposed.posed_clothing(&[frame], offsets.view())?;
            examples.extend(clothing.into_iter().map(|clothing| ExampleFrame {
                label: format!("by {count}"),
                frame,
                clothing: Some(clothing),
            }));
        }
        Ok(examples)
    }

    fn regression(&self, progress: &mut dyn FnMut(usize, usize)) -> Result<ExperimentOutcome> {
        let sequences = &self.unposed.set().sequences;
        let mut runs: Vec<(&str, Vec<usize>)> =
            sequences.iter().enumerate().map(|(k, s)| (s.name.as_str(), vec![k])).collect();
        if runs.len() > 1 {
            runs.push(("all together", (0..sequences.len()).collect()));
        }
        let mut outcome = ExperimentOutcome::default();
        let share = self.unposed.clothing_share()?;
        for (index, (name, of)) in runs.iter().enumerate() {
            let regression = self.unposed.regression(of, self.options, &mut |_, _| {})?;
            let held = &regression.held;
            if index == 0 {
                for &frame in held.iter().skip(held.len() / 4).step_by(1 + held.len() / 3).take(3) {
                    outcome.examples.extend(self.prediction_example(&regression, frame)?);
                }
            }
            outcome.results.regressed.push(self.result(["", name], &regression, share));
            progress(index + 1, runs.len());
        }
        Ok(outcome)
    }

    /// The examples are of the held-out value with the median error.
    fn transfer(
        &self,
        factor: Factor,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<ExperimentOutcome> {
        let groups = factor.held_out_groups(self.unposed.set());
        let share = self.unposed.clothing_share()?;
        let mut regressed = Vec::new();
        let mut examples = Vec::new();
        for (index, group) in groups.iter().enumerate() {
            let regression =
                self.unposed.leave_out(&group.sequences, self.options, &mut |_, _| {})?;
            let (frames, _) = self.unposed.frames_of(&group.sequences);
            let mut shown = Vec::new();
            for share in EXAMPLES {
                let frame = frames[(share * frames.len() as f64) as usize];
                shown.extend(self.prediction_example(&regression, frame)?);
            }
            examples.push((regression.predict.mean, shown));
            regressed.push(self.result([factor.name(), &group.label], &regression, share));
            progress(index + 1, groups.len());
        }
        examples.sort_by(|a, b| a.0.total_cmp(&b.0));
        let median = examples.len().saturating_sub(1) / 2;
        let examples = examples.into_iter().nth(median).map_or(Vec::new(), |(_, shown)| shown);
        let results = ExperimentResults { regressed, ..ExperimentResults::default() };
        Ok(ExperimentOutcome { results, examples })
    }

    /// A frame and its prediction, pushed out of the body.
    fn prediction_example(
        &self,
        regression: &RegressionReport,
        frame: usize,
    ) -> Result<[ExampleFrame; 2]> {
        let features = &self.options.features;
        let predicted = self.unposed.predict(&regression.trained_model, features, &[frame])?;
        let clothing = self.unposed.kept_out(&[frame], predicted)?.into_iter().next();
        let (clothing, _) =
            clothing.ok_or_else(|| Error::argument(format!("no prediction of frame {frame}")))?;
        let label = "predicted".to_owned();
        Ok([
            ExampleFrame::truth(self.unposed.set(), frame),
            ExampleFrame { label, frame, clothing: Some(clothing) },
        ])
    }

    /// A row of a table; `share` is that of the clothing in the dressed surface.
    fn result(
        &self,
        [factor, name]: [&str; 2],
        regression: &RegressionReport,
        share: f64,
    ) -> RegressionResult {
        let outcome = &regression.trained_model.outcome;
        RegressionResult {
            set: self.name.to_owned(),
            factor: factor.to_owned(),
            name: name.to_owned(),
            trained: outcome.training_frames.len(),
            frames: regression.held.len(),
            train_mm: regression.train.mean,
            predict_mm: regression.predict.mean,
            dressed_mm: share * regression.predict.mean,
            predict_each_mm: regression.predict_each.clone(),
            largest_mm: regression.predict.largest,
            space_mm: regression.space.mean,
            baselines: regression.baselines,
            pushed_out: regression.pushed_out,
            iterations: outcome.epochs.len(),
        }
    }
}
