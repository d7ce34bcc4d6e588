//! Priors of latent codes.

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

/// Prior and temperature of sampled codes.
#[derive(Debug, Clone, Copy, Args)]
pub(crate) struct PriorArgs {
    /// Prior of latent codes: Gaussian mixture or kernel density of the training codes, or standard
    /// normal [default: gmm, or normal if the run has no mixture].
    #[arg(long, value_enum, value_name = "PRIOR")]
    pub(crate) prior: Option<PriorName>,
    /// Sampling temperature: below 1 closer to the mean, above 1 more varied.
    #[arg(long, default_value_t = 1.0, value_name = "T")]
    pub(crate) temperature: f64,
}

/// Codes under another outfit.
#[derive(Debug, Clone, Copy, Args)]
pub(crate) struct OutfitChangeArgs {
    /// Keep the latent code under another outfit, as in the paper, instead of moving it to its place among
    /// that outfit's codes.
    #[arg(long)]
    pub(crate) same_code: bool,
}

impl OutfitChangeArgs {
    /// Codes `[to, latent]` of clothing like that of `code`, which is an outfit's, in the outfits `to`: moved by
    /// optimal transport between the run's mixtures, or equal without mixtures of single outfits.
    pub(crate) fn codes(
        self,
        run: &Run,
        code: &[f32],
        from: Outfit,
        to: &[Outfit],
    ) -> Result<Array2<f32>> {
        let shape = |error: ndarray::ShapeError| Error::message(error.to_string());
        let code = Array2::from_shape_vec((1, code.len()), code.to_vec()).map_err(shape)?;
        let prior = if self.same_code { None } else { run.prior()? };
        let moved = |&outfit: &Outfit| match &prior {
            Some(prior) => prior.transport_codes(&code, from, outfit),
            None => Ok(code.clone()),
        };
        let codes = to.iter().map(moved).collect::<std::result::Result<Vec<_>, _>>()?;
        let views: Vec<_> = codes.iter().map(|codes| codes.view()).collect();
        concatenate(Axis(0), &views).map_err(shape)
    }
}

impl PriorArgs {
    pub(crate) fn temperature(&self) -> Result<f64> {
        let temperature = self.temperature;
        if temperature.is_finite() && temperature >= 0.0 {
            return Ok(temperature);
        }
        Err(Error::message(format!("--temperature {temperature}: must be at least 0")))
    }

    /// The prior of the codes of a run.
    pub(crate) fn name(&self, run: &Run) -> PriorName {
        let fitted = || run.has_prior(PriorName::Gmm.name());
        self.prior.unwrap_or_else(|| if fitted() { PriorName::Gmm } else { PriorName::Normal })
    }

    /// Codes `[outfits · n, latent]`, `n` per outfit, outfit by outfit. From the standard normal prior
    /// they are the same for all outfits.
    pub(crate) fn codes(
        &self,
        run: &Run,
        outfits: &[Outfit],
        n: usize,
        seed: u64,
        console: Console,
    ) -> Result<Array2<f32>> {
        let temperature = self.temperature()?;
        let prior = load_prior(run, self.name(run), console)?;
        let of = |&outfit: &Outfit| match &prior {
            Some(prior) => prior.sample(outfit, n, temperature, seed),
            None => run.sample_codes(n, seed) * temperature as f32,
        };
        let codes: Vec<Array2<f32>> = outfits.iter().map(of).collect();
        let views: Vec<_> = codes.iter().map(|codes| codes.view()).collect();
        concatenate(Axis(0), &views).map_err(|error| Error::message(error.to_string()))
    }
}

/// The density fitted to the run's codes; none for the standard normal prior.
pub(crate) fn load_prior(run: &Run, name: PriorName, console: Console) -> Result<Option<Prior>> {
    if name == PriorName::Normal {
        return Ok(None);
    }
    let Some(prior) = run.prior_of_kind(name.name())? else {
        return Err(Error::message(match run.paths() {
            Some(paths) => format!(
                "{}: not found: fit it by `cape model prior {} --kind {}`",
                paths.prior(name.name()).display(),
                paths.root().display(),
                name.name()
            ),
            None => format!(
                "--prior {}: {} has a Gaussian mixture only",
                name.name(),
                run.name().display()
            ),
        }));
    };
    if prior.step().is_some_and(|step| step != run.progress().step) {
        console.note(&format!(
            "warning: the prior of {} was fitted to another checkpoint: fit it again by `cape model \
             prior`",
            run.name().display()
        ));
    }
    Ok(Some(prior))
}
