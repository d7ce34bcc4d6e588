//! Weights and momentum of a model in a TensorFlow checkpoint of the release.

use super::{bare, import, name_map, without_leading_ones};
use crate::{
    CapeConfig, Error, Result,
    tensorflow::{TensorFlowCheckpoint, Variable},
    weights::{HostArray, Weights},
};

/// Scopes of the model's variables.
const ROOTS: [&str; 4] =
    ["condition_pose/", "condition_clo_label/", "generator/", "discriminator/"];
/// Name suffixes of optimiser and averaging state.
const MOMENTUM: &str = "/Momentum";
const SLOTS: [&str; 4] = [MOMENTUM, "/ExponentialMovingAverage", "/Adam", "/Adam_1"];
/// Variable with the number of training steps.
const STEP: &str = "global_step";

/// Contents of a checkpoint of the release.
///
/// ```
/// use cape_model::{release::ReleaseCheckpoint, tensorflow::TensorFlowCheckpoint};
///
/// let released = ReleaseCheckpoint::read(&TensorFlowCheckpoint::open("fixtures/checkpoint")?)?;
/// assert_eq!(released.step, Some(7));
/// assert_eq!(released.shapes(), [("generator/encoder/1x1-conv/weights".to_owned(), vec![3, 2])]);
/// assert!(released.ignored.is_empty());
/// # Ok::<(), cape_model::Error>(())
/// ```
///
/// For a checkpoint of a whole model:
///
/// ```no_run
/// # use cape_model::{release::{ReleaseCheckpoint, infer}, tensorflow::TensorFlowCheckpoint};
/// let released = ReleaseCheckpoint::read(&TensorFlowCheckpoint::open("checkpoints/CAPE_male")?)?;
/// let config = infer(&released.shapes())?;
/// let weights = released.weights(&config)?;
/// # Ok::<(), cape_model::Error>(())
/// ```
#[derive(Debug)]
pub struct ReleaseCheckpoint {
    /// Variables of the model by TensorFlow's names.
    pub variables: Vec<(String, HostArray)>,
    /// Momentum of the optimisers by the names of the variables.
    momentum: Vec<(String, HostArray)>,
    /// Training steps; `None` if the checkpoint has no `global_step`.
    pub step: Option<u64>,
    /// Names of all other variables: moving averages, counters.
    pub ignored: Vec<String>,
}

impl ReleaseCheckpoint {
    /// Reads a checkpoint.
    ///
    /// # Errors
    /// If the checkpoint has no variables of a CAPE model, or a variable is damaged.
    pub fn read(checkpoint: &TensorFlowCheckpoint) -> Result<Self> {
        let mut read =
            Self { variables: Vec::new(), momentum: Vec::new(), step: None, ignored: Vec::new() };
        for variable in checkpoint.variables() {
            let name = variable.name.as_str();
            let ours = ROOTS.iter().any(|root| name.starts_with(root));
            if ours && let Some(owner) = name.strip_suffix(MOMENTUM) {
                read.momentum.push((owner.to_owned(), checkpoint.floats(variable)?));
            } else if SLOTS.iter().any(|slot| name.ends_with(slot)) {
                read.ignored.push(name.to_owned());
            } else if ours {
                read.variables.push((name.to_owned(), checkpoint.floats(variable)?));
            } else if name == STEP || name.ends_with("/global_step") {
                read.step = step(checkpoint, variable)?;
            } else {
                read.ignored.push(name.to_owned());
            }
        }
        if read.variables.is_empty() {
            let names = checkpoint.variables().iter().take(3).map(|v| v.name.as_str());
            return Err(Error::File {
                path: checkpoint.prefix().to_owned(),
                message: format!(
                    "no variable of a CAPE model (expected generator/…); the first variables are {}",
                    names.collect::<Vec<_>>().join(", ")
                ),
            });
        }
        let (owned, alone) = std::mem::take(&mut read.momentum)
            .into_iter()
            .partition(|(owner, _)| read.variables.iter().any(|(name, _)| name == owner));
        read.momentum = owned;
        let alone: Vec<(String, HostArray)> = alone;
        read.ignored.extend(alone.into_iter().map(|(owner, _)| owner + MOMENTUM));
        Ok(read)
    }

    /// The release's name of the parameter `ours`.
    pub fn official_name(&self, config: &CapeConfig, ours: &str) -> Option<String> {
        name_map(config, &self.shapes()).ok()?.remove(ours)
    }

    /// Names and shapes of the model's variables, in the order of the checkpoint.
    pub fn shapes(&self) -> Vec<(String, Vec<usize>)> {
        self.variables.iter().map(|(name, array)| (name.clone(), array.shape.clone())).collect()
    }

    /// Weights of a model of configuration `config`.
    ///
    /// # Errors
    /// If a variable is missing or unknown; it is named.
    pub fn weights(&self, config: &CapeConfig) -> Result<Weights> {
        import(config, &self.variables)
    }

    /// Momentum of the parameters of `part` (`generator` or `discriminator`) by their paths in it;
    /// empty if the checkpoint has none.
    ///
    /// # Errors
    /// As [`weights`](Self::weights), or if a momentum has another shape than its variable.
    pub fn momentum(&self, config: &CapeConfig, part: &str) -> Result<Weights> {
        let mut momentum = Weights::new();
        for (ours, theirs) in name_map(config, &self.shapes())? {
            let Some(path) = ours.strip_prefix(part).and_then(|rest| rest.strip_prefix('.')) else {
                continue;
            };
            let owner = bare(&theirs);
            let Some((_, array)) = self.momentum.iter().find(|(name, _)| name == owner) else {
                continue;
            };
            let shape = self.variables.iter().find(|(name, _)| *name == theirs);
            if shape.is_some_and(|(_, variable)| variable.shape != array.shape) {
                return Err(Error::Weight {
                    name: format!("{owner}{MOMENTUM}"),
                    message: format!("shape {:?}, expected the shape of its variable", array.shape),
                });
            }
            momentum.insert(path.to_owned(), without_leading_ones(array, &theirs));
        }
        Ok(momentum)
    }
}

fn step(checkpoint: &TensorFlowCheckpoint, variable: &Variable) -> Result<Option<u64>> {
    let step = checkpoint.integers(variable)?.first().copied();
    Ok(step.and_then(|step| u64::try_from(step).ok()))
}
