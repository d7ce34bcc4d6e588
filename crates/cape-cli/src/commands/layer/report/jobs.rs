//! Experiments on a set; finished ones are kept.

use std::path::{Path, PathBuf};

use cape_core::SmplModel;
use cape_eval::store::{ResultStore, StoreOptions, StoreSettings, unreadable};
use cape_layer::{
    LayerSet,
    experiment::{Experiment, ExperimentResults, LearningOptions, UnposedSet},
};
use cape_render::Image;
use serde_json::json;

use super::figures;
use crate::{
    body_source::BodySource,
    commands::layer::association::{AssociationArgs, AssociationOutput},
    console::Console,
    error::{Error, Result},
};

/// A set by name.
pub(super) struct NamedSet {
    pub(super) name: String,
    pub(super) directory: PathBuf,
    pub(super) set: LayerSet,
}

/// Common settings of the experiments.
pub(super) struct ExperimentContext<'a> {
    pub(super) model: &'a SmplModel,
    pub(super) learning: LearningOptions,
    pub(super) association_args: AssociationArgs,
    /// Source of the body.
    pub(super) body: &'a BodySource,
    /// Directory with a store of each set's results and pictures.
    pub(super) results: &'a Path,
    /// Discard results of other settings or inputs instead of refusing them.
    pub(super) overwrite: bool,
    pub(super) console: Console,
}

impl ExperimentContext<'_> {
    /// The store of a set's results.
    pub(super) fn store(&self, named: &NamedSet) -> Result<ResultStore> {
        let settings = json!({ "association": self.association_args, "learning": self.learning });
        let sequences = named.set.sequences.iter().map(|sequence| format!("{}.npz", sequence.name));
        let files: Vec<String> = std::iter::once("set.json".into()).chain(sequences).collect();
        let settings = StoreSettings::new("layer report, set", &settings)?;
        let settings = self.body.input_of(settings)?.with_files("set", &named.directory, &files)?;
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
        self.console.while_showing(&title, "runs", |progress| {
            let outcome = job.run(&named.name, unposed, &self.learning, progress)?;
            let image = figures::errors(self.model, named, &outcome.examples)?;
            Ok::<_, Error>((outcome.results, image))
        })
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
