//! What codes are drawn from.

use cape_core::Outfit;
use cape_infer::{Run, prior::Prior};
use clap::{Args, ValueEnum};
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

/// What codes are drawn from, as commands ask for it.
#[derive(Debug, Clone, Copy, Args)]
pub(crate) struct PriorArgs {
    /// What codes are drawn from: the standard normal prior, or the mixture or kernel density that
    /// `cape fit-prior` fitted.
    #[arg(long, value_enum, default_value_t = PriorName::Normal)]
    pub(crate) prior: PriorName,
    /// Factor on how far codes are from what is typical: below 1 plainer, above 1 wilder.
    #[arg(long, default_value_t = 1.0, value_name = "T")]
    pub(crate) temperature: f64,
}

impl PriorArgs {
    pub(crate) fn temperature(&self) -> Result<f64> {
        let temperature = self.temperature;
        if temperature.is_finite() && temperature >= 0.0 {
            return Ok(temperature);
        }
        Err(Error::message(format!("--temperature {temperature}: expected 0 or more")))
    }

    /// `n` codes for each of `outfits`, one outfit's below the other's, `[outfits · n, latent]`. From
    /// the standard normal prior they are the same for all outfits.
    pub(crate) fn codes(
        &self,
        run: &Run,
        outfits: &[Outfit],
        n: usize,
        seed: u64,
        console: Console,
    ) -> Result<Array2<f32>> {
        let temperature = self.temperature()?;
        let prior = load_prior(run, self.prior, console)?;
        let of = |&outfit: &Outfit| match &prior {
            Some(prior) => prior.sample(outfit, n, temperature, seed),
            None => run.sample_codes(n, seed) * temperature as f32,
        };
        let codes: Vec<Array2<f32>> = outfits.iter().map(of).collect();
        let views: Vec<_> = codes.iter().map(|codes| codes.view()).collect();
        concatenate(Axis(0), &views).map_err(|error| Error::message(error.to_string()))
    }
}

/// The density that was fitted to the run's codes; none for the standard normal prior.
pub(crate) fn load_prior(run: &Run, name: PriorName, console: Console) -> Result<Option<Prior>> {
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
