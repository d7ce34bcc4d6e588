//! Checkpoints: directories with everything that resuming needs, written atomically.

use std::{
    fs,
    io::{ErrorKind, Write},
    path::{Path, PathBuf},
};

use cape_core::sha256_of_file;
use cape_model::weights::{self, Weights};
use serde::{Deserialize, Serialize};

use crate::{Error, Result};
use cape_data::LoaderState;

const MODEL: &str = "model.safetensors";
const GENERATOR_MOMENTUM: &str = "generator_momentum.safetensors";
const DISCRIMINATOR_MOMENTUM: &str = "discriminator_momentum.safetensors";
/// File of the averaged weights of the generator, if the run averages them.
const AVERAGE: &str = "generator_average.safetensors";
const STATE: &str = "state.json";
/// SHA-256 of the other files, as `sha256sum` writes and checks them.
const SUMS: &str = "SHA256SUMS";
const PREFIX: &str = "step-";
const PARTIAL: &str = ".partial-";
const DAMAGED: &str = "damaged-";

/// State of a training besides its weights.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainState {
    /// Number of updates done.
    pub step: u64,
    /// State of the shuffled loader: the next frames to draw.
    pub loader: LoaderState,
    /// Training time so far, seconds.
    pub seconds: f64,
    /// Sum of the discriminator's accuracies over the epoch's updates so far, and their number.
    #[serde(default, rename = "judged")]
    pub accuracy_sum: (f32, usize),
    /// Validation error after the last whole epoch, millimetres.
    pub validation: Option<f64>,
    /// The lowest validation error so far and the step it was reached at.
    pub best: Option<(f64, u64)>,
}

/// State of a training with all weights.
///
/// ```
/// use std::collections::BTreeMap;
///
/// use cape_model::weights::{HostArray, Weights};
/// use cape_data::LoaderState;
/// use cape_infer::checkpoint::{self, Checkpoint, TrainState};
///
/// let mut model = Weights::new();
/// let bias = HostArray { shape: vec![2], values: vec![1., 2.] };
/// model.insert("generator.encoder.mean.bias".into(), bias);
/// let saved = Checkpoint {
///     progress: TrainState {
///         step: 12,
///         loader: LoaderState::new(1),
///         seconds: 3.5,
///         accuracy_sum: (0.0, 0),
///         validation: Some(6.1),
///         best: Some((6.1, 12)),
///     },
///     model,
///     generator_momentum: BTreeMap::new(),
///     discriminator_momentum: BTreeMap::new(),
///     average: None,
/// };
/// let directory = tempfile::tempdir()?;
/// let path = saved.save(directory.path())?;
/// assert_eq!(checkpoint::best(directory.path())?, path);
/// let loaded = Checkpoint::load(&path)?;
/// assert_eq!((loaded.progress, loaded.model), (saved.progress, saved.model));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct Checkpoint {
    /// State besides the weights.
    pub progress: TrainState,
    /// Weights of the model.
    pub model: Weights,
    /// Moments of the generator's optimiser.
    pub generator_momentum: Weights,
    /// Moments of the discriminator's optimiser.
    pub discriminator_momentum: Weights,
    /// Averaged weights of the generator, if the run averages them.
    pub average: Option<Weights>,
}

impl Checkpoint {
    /// Writes `directory/step-N` by way of a temporary directory; one already there for the same
    /// step is replaced.
    pub fn save(&self, directory: &Path) -> Result<PathBuf> {
        let io = |path: &Path| {
            let path = path.to_owned();
            move |source| Error::io(path, source)
        };
        let name = format!("{PREFIX}{:08}", self.progress.step);
        let partial = directory.join(format!("{PARTIAL}{name}"));
        let path = directory.join(&name);
        fs::create_dir_all(directory).map_err(io(directory))?;
        remove_partial(directory)?;
        fs::create_dir(&partial).map_err(io(&partial))?;
        let written = self.write_into(&partial);
        if let Err(error) = written {
            // What could not be completed is of no use; the error that stopped it matters more.
            let _ = fs::remove_dir_all(&partial);
            return Err(error);
        }
        if path.exists() {
            fs::remove_dir_all(&path).map_err(io(&path))?;
        }
        fs::rename(&partial, &path).map_err(io(&path))?;
        Ok(path)
    }

    fn write_into(&self, directory: &Path) -> Result<()> {
        weights::save(&self.model, directory.join(MODEL))?;
        weights::save(&self.generator_momentum, directory.join(GENERATOR_MOMENTUM))?;
        weights::save(&self.discriminator_momentum, directory.join(DISCRIMINATOR_MOMENTUM))?;
        if let Some(average) = &self.average {
            weights::save(average, directory.join(AVERAGE))?;
        }
        let path = directory.join(STATE);
        let state = serde_json::to_vec_pretty(&self.progress)
            .map_err(|error| Error::format(&path, error.to_string()))?;
        cape_core::write_atomically(&path, |file| file.write_all(&state))?;
        let average = self.average.is_some().then_some(AVERAGE);
        let names = [MODEL, GENERATOR_MOMENTUM, DISCRIMINATOR_MOMENTUM, STATE];
        let sum = |name| Ok(format!("{}  {name}\n", sha256_of_file(directory.join(name))?));
        let sums = names.into_iter().chain(average).map(sum).collect::<Result<String>>()?;
        let path = directory.join(SUMS);
        Ok(cape_core::write_atomically(path, |file| file.write_all(sums.as_bytes()))?)
    }

    /// Reads a checkpoint directory.
    ///
    /// # Errors
    /// If a file is missing or malformed, or does not have the SHA-256 that it was written with.
    pub fn load(path: &Path) -> Result<Self> {
        Ok(Self {
            progress: load_progress(path)?,
            model: load_file(path, MODEL)?,
            generator_momentum: load_file(path, GENERATOR_MOMENTUM)?,
            discriminator_momentum: load_file(path, DISCRIMINATOR_MOMENTUM)?,
            average: load_average(path)?,
        })
    }

    /// Reads the newest checkpoint of a run that can be read, with its path; `None` if there is none at all.
    /// Newer ones, which are damaged, are renamed to `damaged-step-N`, so that training can go on from this
    /// one.
    ///
    /// # Errors
    /// If all checkpoints are damaged, or one cannot be opened or renamed.
    pub fn load_newest(directory: &Path) -> Result<(LoadedCheckpoint, Vec<DamagedCheckpoint>)> {
        let (mut damaged, mut found) = (Vec::new(), None);
        for (_, path) in list(directory)?.into_iter().rev() {
            match Self::load(&path) {
                Ok(checkpoint) => {
                    found = Some((path, checkpoint));
                    break;
                }
                Err(error) if is_damage(&error) => damaged.push((path, error)),
                Err(error) => return Err(error),
            }
        }
        if found.is_none()
            && let Some((_, newest)) = damaged.first()
        {
            return Err(Error::data(format!(
                "{newest}; no other checkpoint of the run can be read: remove {} to start over",
                directory.display()
            )));
        }
        let damaged = damaged.iter().map(|(path, error)| set_aside(path, error));
        Ok((found, damaged.collect::<Result<_>>()?))
    }
}

/// A checkpoint and its path, if there is one.
type LoadedCheckpoint = Option<(PathBuf, Checkpoint)>;

/// A checkpoint that cannot be read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DamagedCheckpoint {
    /// Directory that it was renamed to.
    pub path: PathBuf,
    /// File and fault.
    pub reason: String,
}

/// Renames a damaged checkpoint, so that it counts no more.
fn set_aside(path: &Path, error: &Error) -> Result<DamagedCheckpoint> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let place = |number: usize| match number {
        1 => path.with_file_name(format!("{DAMAGED}{name}")),
        _ => path.with_file_name(format!("{DAMAGED}{name}-{number}")),
    };
    let free = (1..1000).map(place).find(|place| !place.exists()).unwrap_or_else(|| place(1));
    fs::rename(path, &free).map_err(|source| Error::io(path, source))?;
    Ok(DamagedCheckpoint { path: free, reason: error.to_string() })
}

/// True for what a damaged file causes, false if the system refuses access.
fn is_damage(error: &Error) -> bool {
    match error {
        Error::Core(cape_core::Error::Io { source, .. }) => matches!(
            source.kind(),
            ErrorKind::NotFound | ErrorKind::UnexpectedEof | ErrorKind::InvalidData
        ),
        _ => true,
    }
}

/// Removes checkpoints whose writing was cut off.
fn remove_partial(directory: &Path) -> Result<()> {
    let io = |source| Error::io(directory, source);
    for entry in fs::read_dir(directory).map_err(io)? {
        let entry = entry.map_err(io)?;
        if entry.file_name().to_string_lossy().starts_with(PARTIAL) {
            fs::remove_dir_all(entry.path()).map_err(io)?;
        }
    }
    Ok(())
}

/// Returns an error if the file `name` does not have the SHA-256 in the checkpoint's list. Checkpoints of
/// earlier versions have no list.
fn verify(directory: &Path, name: &str) -> Result<()> {
    let path = directory.join(SUMS);
    let sums = match fs::read_to_string(&path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
        sums => sums.map_err(|source| Error::io(&path, source))?,
    };
    let listed = sums.lines().filter_map(|line| line.split_once("  "));
    let Some((expected, _)) = listed.into_iter().find(|(_, listed)| *listed == name) else {
        return Err(Error::format(&path, format!("has no line of {name}")));
    };
    let path = directory.join(name);
    if sha256_of_file(&path)? == expected {
        return Ok(());
    }
    Err(Error::format(&path, format!("does not have the SHA-256 in {SUMS}: it is damaged")))
}

fn load_file(directory: &Path, name: &str) -> Result<Weights> {
    verify(directory, name)?;
    Ok(weights::load(directory.join(name))?)
}

fn load_average(directory: &Path) -> Result<Option<Weights>> {
    let listed = fs::read_to_string(directory.join(SUMS)).is_ok_and(|sums| sums.contains(AVERAGE));
    let there = listed || directory.join(AVERAGE).exists();
    there.then(|| load_file(directory, AVERAGE)).transpose()
}

/// Reads where a checkpoint directory's run was.
pub fn load_progress(path: &Path) -> Result<TrainState> {
    verify(path, STATE)?;
    let path = path.join(STATE);
    let text = fs::read(&path).map_err(|source| Error::io(&path, source))?;
    serde_json::from_slice(&text).map_err(|error| Error::format(&path, error.to_string()))
}

/// Reads the weights of a checkpoint directory: the generator's averaged ones, where there are any.
pub fn load_weights(path: &Path) -> Result<Weights> {
    let mut weights = load_file(path, MODEL)?;
    let average = load_average(path)?.unwrap_or_default();
    weights.extend(average.into_iter().map(|(name, array)| (format!("generator.{name}"), array)));
    Ok(weights)
}

/// Names of the files of a checkpoint directory that [`load_weights`] reads.
pub fn weight_files(path: &Path) -> Vec<String> {
    let average = path.join(AVERAGE).exists().then(|| AVERAGE.to_owned());
    std::iter::once(MODEL.to_owned()).chain(average).collect()
}

/// The checkpoints of a run, oldest first.
pub fn list(directory: &Path) -> Result<Vec<(u64, PathBuf)>> {
    let entries = match fs::read_dir(directory) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(source) => return Err(Error::io(directory, source)),
    };
    let mut found = Vec::new();
    for entry in entries {
        let path = entry.map_err(|source| Error::io(directory, source))?.path();
        let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        if let Some(step) = name.strip_prefix(PREFIX).and_then(|step| step.parse().ok()) {
            found.push((step, path));
        }
    }
    found.sort();
    Ok(found)
}

/// The best checkpoint by validation error, else the newest.
pub fn best(directory: &Path) -> Result<PathBuf> {
    let all = list(directory)?;
    let Some((_, newest)) = all.last() else {
        return Err(Error::data(format!("{}: no checkpoint yet", directory.display())));
    };
    let best = load_progress(newest)?.best.map(|(_, step)| step);
    let path = all.iter().find(|(step, _)| Some(*step) == best).map(|(_, path)| path);
    Ok(path.unwrap_or(newest).clone())
}

/// Removes all but the newest `keep` checkpoints and the best one. Of those at steps that are not
/// `regular`, saved by time or at an interruption, only the newest of all is kept.
pub fn prune(
    directory: &Path,
    keep: usize,
    best: Option<u64>,
    regular: impl Fn(u64) -> bool,
) -> Result<()> {
    let mut all = list(directory)?;
    let newest = all.last().map(|(step, _)| *step);
    let (kept, mut old): (Vec<_>, Vec<_>) =
        all.drain(..).partition(|(step, _)| regular(*step) || Some(*step) == newest);
    old.extend_from_slice(&kept[..kept.len().saturating_sub(keep.max(1))]);
    for (step, path) in &old {
        if Some(*step) != best {
            fs::remove_dir_all(path).map_err(|source| Error::io(path, source))?;
        }
    }
    Ok(())
}
