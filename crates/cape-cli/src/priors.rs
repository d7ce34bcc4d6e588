//! What codes are drawn from.

use cape_core::Outfit;
use cape_train::{Run, prior::Prior};
use clap::ValueEnum;
use ndarray::{Array2, Axis, concatenate};

use crate::{
    console::Console,
    error::{Error, Result},
};

/// A prior by its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum PriorName {
    Normal,
    Gmm,
    Kde,
}

impl PriorName {
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Normal => "normal",
            Self::Gmm => "gmm",
            Self::Kde => "kde",
        }
    }
}

pub(crate) fn checked_temperature(temperature: f64) -> Result<f64> {
    if temperature.is_finite() && temperature >= 0.0 {
        return Ok(temperature);
    }
    Err(Error::message(format!("--temperature {temperature}: expected 0 or more")))
}

/// The density that was fitted to the run's codes; none for the standard normal prior.
pub(crate) fn fitted(run: &Run, name: PriorName, console: Console) -> Result<Option<Prior>> {
    if name == PriorName::Normal {
        return Ok(None);
    }
    let path = run.paths().prior(name.name());
    if !path.exists() {
        return Err(Error::message(format!(
            "{}: not there yet: make it by `cape fit-prior {} --kind {}`",
            path.display(),
            run.paths().root().display(),
            name.name()
        )));
    }
    let prior = Prior::load(&path)?;
    let latent = run.config().model.latent;
    if prior.latent() != latent {
        return Err(Error::message(format!(
            "{}: codes of {} numbers, the model's have {latent}",
            path.display(),
            prior.latent()
        )));
    }
    if prior.step().is_some_and(|step| step != run.progress().step) {
        console.note(&format!(
            "{} was fitted to another checkpoint: fit it again for this one",
            path.display()
        ));
    }
    Ok(Some(prior))
}

/// `n` codes for each of `outfits`, one outfit's below the other's, `[outfits · n, latent]`. From the
/// standard normal prior they are the same for all outfits.
pub(crate) fn codes(
    run: &Run,
    name: PriorName,
    outfits: &[Outfit],
    n: usize,
    temperature: f64,
    seed: u64,
    console: Console,
) -> Result<Array2<f32>> {
    let prior = fitted(run, name, console)?;
    let of = |&outfit: &Outfit| match &prior {
        Some(prior) => prior.sample(outfit, n, temperature, seed),
        None => run.sample_codes(n, seed) * temperature as f32,
    };
    let codes: Vec<Array2<f32>> = outfits.iter().map(of).collect();
    let views: Vec<_> = codes.iter().map(|codes| codes.view()).collect();
    concatenate(Axis(0), &views).map_err(|error| Error::message(error.to_string()))
}
