//! The experiments on a set, kept so that an interrupted report goes on.

use std::{fs, path::Path};

use cape_core::SmplModel;
use cape_infer::write_json;
use cape_layer::{
    LayerSet,
    experiment::{Experiment, ExperimentResults, LearningOptions, UnposedSet},
};
use cape_render::Image;
use serde::{Deserialize, Serialize};

use super::figures;
use crate::{
    commands::layer::association::{AssociationArgs, AssociationOutput},
    console::Console,
    error::{Error, Result},
};

/// A set by name.
pub(super) struct NamedSet {
    pub(super) name: String,
    pub(super) set: LayerSet,
}

/// Results of an experiment with the key of their settings, as they are kept.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
struct KeptResults {
    key: String,
    #[serde(flatten)]
    results: ExperimentResults,
}

/// What all experiments share.
pub(super) struct ExperimentContext<'a> {
    pub(super) model: &'a SmplModel,
    pub(super) learning: LearningOptions,
    pub(super) association_args: AssociationArgs,
    /// Where outcomes and pictures are kept.
    pub(super) kept: &'a Path,
    pub(super) console: Console,
}

impl ExperimentContext<'_> {
    /// The outcomes and pictures of all experiments on a set.
    pub(super) fn work(
        &self,
        named: &NamedSet,
    ) -> Result<Vec<(Experiment, ExperimentResults, Image)>> {
        let jobs = Experiment::for_set(&named.set);
        let key =
            format!("{} {:?} {:?}", named.set.fingerprint(), self.association_args, self.learning);
        let done: Vec<Option<(ExperimentResults, Image)>> =
            jobs.iter().map(|&job| self.kept(named, job, &key)).collect();
        let bench =
            if done.iter().all(Option::is_some) { None } else { Some(self.associate(named)?) };
        let unposed = bench.as_ref().map(|tied| self.unpose(named, tied)).transpose()?;
        let mut found = Vec::new();
        for (job, done) in jobs.into_iter().zip(done) {
            let (outcome, image) = match (done, &unposed) {
                (Some(done), _) => {
                    self.console.note(&format!("{}, {}: done before", named.name, job.name()));
                    done
                }
                (None, Some(unposed)) => {
                    let (outcome, image) = self.run(named, unposed, job)?;
                    image.save(self.path(named, job, "png"))?;
                    // The results come last: where they are, their picture is too.
                    let kept = KeptResults { key: key.clone(), results: outcome.clone() };
                    write_json(&self.path(named, job, "json"), &kept)?;
                    // As it will be read from now on, to the last digit.
                    self.kept(named, job, &key).unwrap_or((outcome, image))
                }
                (None, None) => continue,
            };
            found.push((job, outcome, image));
        }
        Ok(found)
    }

    fn path(&self, named: &NamedSet, job: Experiment, extension: &str) -> std::path::PathBuf {
        self.kept.join(format!("{}-{}.{extension}", named.name, job.name()))
    }

    fn kept(
        &self,
        named: &NamedSet,
        job: Experiment,
        key: &str,
    ) -> Option<(ExperimentResults, Image)> {
        let text = fs::read(self.path(named, job, "json")).ok()?;
        let kept: KeptResults = serde_json::from_slice(&text).ok()?;
        let image = Image::load(self.path(named, job, "png")).ok()?;
        (kept.key == key).then_some((kept.results, image))
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
