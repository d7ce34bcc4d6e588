//! Experiments on a set; finished ones are kept.

use std::path::{Path, PathBuf};

use cape_core::SmplModel;
use cape_eval::store::{ResultStore, StoreOptions, StoreSettings, unreadable};
use cape_layer::{
    LayerSet,
    experiment::{Factor, LayerError, LearningOptions, RegressionReport, UnposedSet},
};
use cape_render::Image;
use ndarray::{Array2, Axis};
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::figures::{self, FrameFigure};
use crate::{
    commands::layer::association::{AssociationArgs, AssociationOutput},
    console::Console,
    error::{Error, Result},
};

/// Frames of a held-out group that are shown, as shares of its length.
const MOMENTS: [f64; 3] = [0.2, 0.5, 0.8];

/// A set by name.
pub(super) struct NamedSet {
    pub(super) name: String,
    pub(super) directory: PathBuf,
    pub(super) set: LayerSet,
}

/// An experiment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Experiment {
    /// Table 1.
    Reconstruction,
    /// Table 2.
    Regression,
    /// Prediction of left-out values of a factor.
    Transfer(Factor),
}

/// A line of table 1: mean errors with as many components as the header says, millimetres.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct ReconstructionResult {
    pub(super) set: String,
    pub(super) sequence: String,
    pub(super) frames: usize,
    pub(super) components: Vec<usize>,
    pub(super) errors_mm: Vec<f64>,
    /// Largest with all components.
    pub(super) largest_mm: f64,
}

/// A line of table 2 or of the predictions of left-out values: errors, millimetres.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct RegressionResult {
    pub(super) set: String,
    /// Factor whose values are left out; empty in table 2.
    pub(super) factor: String,
    /// The sequence, or what the held-out ones have in common.
    pub(super) name: String,
    /// Frames that trained.
    pub(super) trained: usize,
    /// Frames that were predicted.
    pub(super) frames: usize,
    pub(super) train_mm: f64,
    pub(super) predict_mm: f64,
    pub(super) largest_mm: f64,
    /// Error of the projection of the predicted frames on the first components.
    pub(super) space_mm: f64,
    /// Error of the mean of the training frames.
    pub(super) baseline_mm: f64,
    pub(super) iterations: usize,
}

/// Results of an experiment.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(super) struct ExperimentResults {
    pub(super) reconstructed: Vec<ReconstructionResult>,
    pub(super) regressed: Vec<RegressionResult>,
}

/// Common settings of the experiments.
pub(super) struct ExperimentContext<'a> {
    pub(super) model: &'a SmplModel,
    pub(super) learning: LearningOptions,
    pub(super) association_args: AssociationArgs,
    /// File of the body; none for the synthetic one.
    pub(super) body: Option<&'a Path>,
    /// Directory with a store of each set's results and pictures.
    pub(super) results: &'a Path,
    /// Discard results of other settings or inputs instead of refusing them.
    pub(super) overwrite: bool,
    pub(super) console: Console,
}

impl Experiment {
    /// Experiments that a set allows.
    pub(super) fn for_set(set: &LayerSet) -> Vec<Self> {
        let transfers = Factor::ALL.into_iter().filter(|factor| factor.groups(set).len() > 1);
        [Self::Reconstruction, Self::Regression]
            .into_iter()
            .chain(transfers.map(Self::Transfer))
            .collect()
    }

    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Reconstruction => "reconstruction",
            Self::Regression => "regression",
            Self::Transfer(factor) => factor.name(),
        }
    }
}

impl ExperimentContext<'_> {
    /// The store of a set's results.
    pub(super) fn store(&self, named: &NamedSet) -> Result<ResultStore> {
        let settings = json!({ "association": self.association_args, "learning": self.learning });
        let sequences = named.set.sequences.iter().map(|sequence| format!("{}.npz", sequence.name));
        let files: Vec<String> = std::iter::once("set.json".into()).chain(sequences).collect();
        let settings = StoreSettings::new("layer report, set", &settings)?
            .with_optional_input("body", self.body, "synthetic body")?
            .with_files("set", &named.directory, &files)?;
        let options = StoreOptions { overwrite: self.overwrite, ..StoreOptions::default() };
        Ok(ResultStore::open(&self.results.join(&named.name), settings, options)?)
    }

    /// The outcomes and pictures of all experiments on a set.
    pub(super) fn work(
        &self,
        named: &NamedSet,
        store: &ResultStore,
    ) -> Result<Vec<(Experiment, ExperimentResults, Image)>> {
        let jobs = Experiment::for_set(&named.set);
        let done: Vec<Option<(ExperimentResults, Image)>> =
            jobs.iter().map(|&job| kept(store, job)).collect::<Result<_>>()?;
        let bench =
            if done.iter().all(Option::is_some) { None } else { Some(self.associate(named)?) };
        let unposed = bench.as_ref().map(|tied| self.unpose(named, tied)).transpose()?;
        let mut found = Vec::new();
        for (job, done) in jobs.into_iter().zip(done) {
            let (outcome, image) = match (done, &unposed) {
                (Some(done), _) => {
                    self.console.note(&format!("{}, {}: already done", named.name, job.name()));
                    done
                }
                (None, Some(unposed)) => {
                    let (outcome, image) = self.run(named, unposed, job)?;
                    image.save(store.claim(&file(job, "png"))?)?;
                    // The outcome comes last: where it is, its picture is too.
                    (store.write(&file(job, "json"), &outcome)?, image)
                }
                (None, None) => continue,
            };
            found.push((job, outcome, image));
        }
        Ok(found)
    }

    fn associate(&self, named: &NamedSet) -> Result<AssociationOutput> {
        self.association_args.associate(self.model, &named.set, self.console)
    }

    fn unpose<'b>(
        &'b self,
        named: &'b NamedSet,
        tied: &'b AssociationOutput,
    ) -> Result<UnposedSet<'b>> {
        let standard = self.association_args.standard();
        Ok(UnposedSet::new(self.model, &named.set, &tied.association, &standard)?)
    }

    fn run(
        &self,
        named: &NamedSet,
        unposed: &UnposedSet,
        job: Experiment,
    ) -> Result<(ExperimentResults, Image)> {
        let title = format!("{}, {}", named.name, job.name());
        self.console.while_showing(&title, "runs", |progress| match job {
            Experiment::Reconstruction => self.reconstruction(named, unposed, progress),
            Experiment::Regression => self.regression(named, unposed, progress),
            Experiment::Transfer(factor) => self.transfer(named, unposed, factor, progress),
        })
    }

    fn reconstruction(
        &self,
        named: &NamedSet,
        unposed: &UnposedSet,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<(ExperimentResults, Image)> {
        let mut counts = vec![1, 5, self.learning.components];
        counts.sort_unstable();
        counts.dedup();
        let mut lines = Vec::new();
        for (index, sequence) in named.set.sequences.iter().enumerate() {
            let errors = unposed.reconstruction_of(index, &counts)?;
            let all = errors.last().copied().unwrap_or(LayerError::over(&[]));
            lines.push(ReconstructionResult {
                set: named.name.clone(),
                sequence: sequence.name.clone(),
                frames: sequence.frames(),
                components: counts.clone(),
                errors_mm: errors.iter().map(|error| error.mean).collect(),
                largest_mm: all.largest,
            });
            progress(index + 1, named.set.sequences.len());
        }
        let image = self.shown_reconstructions(named, unposed, &counts)?;
        Ok((ExperimentResults { reconstructed: lines, ..ExperimentResults::default() }, image))
    }

    /// The middle frame of the first sequence by its own components.
    fn shown_reconstructions(
        &self,
        named: &NamedSet,
        unposed: &UnposedSet,
        counts: &[usize],
    ) -> Result<Image> {
        let (frames, _) = unposed.frames_of(&[0]);
        let rows = unposed.rows.select(Axis(0), &frames);
        let all = cape_layer::LayerPca::fit(rows.view(), cape_layer::ComponentSelection::All)?;
        let middle = frames.len() / 2;
        let row = rows.slice(ndarray::s![middle..=middle, ..]);
        let mut shown = vec![FrameFigure::truth(named, frames[middle])];
        for &count in counts {
            let pca = all.truncated(count);
            let offsets = pca.decode(pca.encode(row)?.view())?;
            let clothing = unposed.posed_clothing(&[frames[middle]], offsets.view())?;
            let label = format!("by {count}");
            shown.extend(
                clothing.into_iter().map(|c| FrameFigure::new(label.clone(), frames[middle], c)),
            );
        }
        figures::errors(self.model, named, &shown)
    }

    fn regression(
        &self,
        named: &NamedSet,
        unposed: &UnposedSet,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<(ExperimentResults, Image)> {
        let sequences = &named.set.sequences;
        let mut runs: Vec<(String, Vec<usize>)> =
            sequences.iter().enumerate().map(|(k, s)| (s.name.clone(), vec![k])).collect();
        if runs.len() > 1 {
            runs.push(("all together".into(), (0..sequences.len()).collect()));
        }
        let mut lines = Vec::new();
        let mut shown = Vec::new();
        for (index, (name, of)) in runs.iter().enumerate() {
            let regression = unposed.regression(of, &self.learning, &mut |_| {})?;
            let (frames, _) = unposed.frames_of(of);
            let held = &regression.trained_model.outcome.validation_frames;
            if index == 0 {
                for &at in held.iter().skip(held.len() / 4).step_by(1 + held.len() / 3).take(3) {
                    shown.extend(self.shown(named, unposed, &regression, frames[at])?);
                }
            }
            lines.push(RegressionResult::new(named, "", name, &regression, held.len()));
            progress(index + 1, runs.len());
        }
        let image = figures::errors(self.model, named, &shown)?;
        Ok((ExperimentResults { regressed: lines, ..ExperimentResults::default() }, image))
    }

    fn transfer(
        &self,
        named: &NamedSet,
        unposed: &UnposedSet,
        factor: Factor,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<(ExperimentResults, Image)> {
        let groups = factor.groups(&named.set);
        let mut lines = Vec::new();
        let mut pictures = Vec::new();
        for (index, group) in groups.iter().enumerate() {
            let regression = unposed.transfer(&group.sequences, &self.learning, &mut |_| {})?;
            let (frames, _) = unposed.frames_of(&group.sequences);
            let mut shown = Vec::new();
            for moment in MOMENTS {
                let frame = frames[(moment * frames.len() as f64) as usize];
                shown.extend(self.shown(named, unposed, &regression, frame)?);
            }
            pictures.push((regression.predict.mean, shown));
            let line = RegressionResult::new(
                named,
                factor.name(),
                &group.label,
                &regression,
                frames.len(),
            );
            lines.push(line);
            progress(index + 1, groups.len());
        }
        // Neither the best nor the worst.
        pictures.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (_, shown) = &pictures[(pictures.len() - 1) / 2];
        let image = figures::errors(self.model, named, shown)?;
        Ok((ExperimentResults { regressed: lines, ..ExperimentResults::default() }, image))
    }

    /// A frame as it is and as it is predicted.
    fn shown(
        &self,
        named: &NamedSet,
        unposed: &UnposedSet,
        regression: &RegressionReport,
        frame: usize,
    ) -> Result<Vec<FrameFigure>> {
        let features = &self.learning.features;
        let predicted: Vec<Array2<f64>> =
            unposed.predict(&regression.trained_model, features, &[frame])?;
        let predicted = predicted.into_iter().next();
        let predicted = predicted.ok_or_else(|| Error::message("nothing was predicted"))?;
        Ok(vec![
            FrameFigure::truth(named, frame),
            FrameFigure::new("predicted".into(), frame, predicted),
        ])
    }
}

/// Name of an experiment's file.
fn file(job: Experiment, extension: &str) -> String {
    format!("{}.{extension}", job.name())
}

/// The outcome and the picture of a finished experiment.
fn kept(store: &ResultStore, job: Experiment) -> Result<Option<(ExperimentResults, Image)>> {
    let Some(outcome) = store.read(&file(job, "json"))? else { return Ok(None) };
    let picture = store.path(&file(job, "png"));
    if !picture.exists() {
        return Ok(None);
    }
    let image = Image::load(&picture).map_err(|error| unreadable(&picture, &error.to_string()))?;
    Ok(Some((outcome, image)))
}

impl RegressionResult {
    fn new(
        named: &NamedSet,
        factor: &str,
        name: &str,
        regression: &RegressionReport,
        frames: usize,
    ) -> Self {
        let outcome = &regression.trained_model.outcome;
        Self {
            set: named.name.clone(),
            factor: factor.to_owned(),
            name: name.to_owned(),
            trained: outcome.training_frames.len(),
            frames,
            train_mm: regression.train.mean,
            predict_mm: regression.predict.mean,
            largest_mm: regression.predict.largest,
            space_mm: regression.space.mean,
            baseline_mm: regression.mean_baseline.mean,
            iterations: outcome.epochs.len(),
        }
    }
}
