//! Finished frames on disk, and the settings they belong to.

use std::path::Path;

use cape_core::DirectoryLock;
use cape_data::Split;
use cape_eval::store::{ResultStore, StoreOptions, StoreSettings};
use cape_fit::{
    FitConfig,
    benchmark::{BenchmarkCase, BenchmarkOptions},
};
use cape_infer::Run;
use serde_json::json;

use super::SubjectShapes;
use crate::error::Result;

/// Files from versions that did not record the SHA-256 of the inputs.
const EARLIER: [&str; 14] = [
    "settings.json",
    "frames/*.json",
    "results.json",
    "errors.png",
    "fits.png",
    "best/keypoints.json",
    "best/mask.png",
    "best/image.png",
    "median/keypoints.json",
    "median/mask.png",
    "median/image.png",
    "worst/keypoints.json",
    "worst/mask.png",
    "worst/image.png",
];

/// Inputs and settings that finished frames depend on.
#[derive(Debug)]
pub(super) struct FrameInputs<'a> {
    pub(super) run: &'a Run,
    pub(super) data: &'a Path,
    pub(super) pose_prior: Option<&'a Path>,
    pub(super) bodies: Option<&'a SubjectShapes>,
    pub(super) options: BenchmarkOptions,
    pub(super) config: &'a FitConfig,
}

/// A benchmark's directory, locked.
#[derive(Debug)]
pub(super) struct CaseStore {
    store: ResultStore,
    _lock: DirectoryLock,
}

impl CaseStore {
    /// The store in `out`. A frame is the same whatever other frames there are, so that their number
    /// is no setting.
    pub(super) fn open(out: &Path, inputs: &FrameInputs<'_>, overwrite: bool) -> Result<Self> {
        let FrameInputs { run, data, pose_prior, bodies, options, config } = inputs;
        let BenchmarkOptions { frames: _, tuning: _, side, noise, bias, dropped, ragged, seed } =
            options;
        let options = json!({
            "side": side, "noise": noise, "bias": bias, "dropped": dropped, "ragged": ragged, "seed": seed,
        });
        let settings = json!({ "options": options, "config": config });
        let settings = StoreSettings::new("fit benchmark image", &settings)?
            .with_run(run)?
            .with_packed_set(data, &[Split::Test])?
            .with_optional_input("pose_prior", *pose_prior, "prior of synthetic motions")?;
        let settings = match bodies {
            Some(SubjectShapes { directory, files, .. }) => {
                settings.with_files("bodies", directory, files)?
            }
            None => settings.with_built_in("bodies", "random shapes"),
        };
        let options = StoreOptions { overwrite, earlier: &EARLIER, ..StoreOptions::default() };
        let store = ResultStore::open(out, settings, options)?;
        let lock = store.lock()?;
        store.begin()?;
        Ok(Self { store, _lock: lock })
    }

    /// The directory with its list of files.
    pub(super) fn files(&self) -> &ResultStore {
        &self.store
    }

    /// A finished frame.
    pub(super) fn case(&self, frame: usize) -> Result<Option<BenchmarkCase>> {
        Ok(self.store.read(&item(frame))?)
    }

    /// Stores a frame and returns it as it will be read.
    pub(super) fn keep(&self, case: &BenchmarkCase) -> Result<BenchmarkCase> {
        Ok(self.store.write(&item(case.frame), case)?)
    }
}

fn item(frame: usize) -> String {
    format!("frames/{frame:06}.json")
}
