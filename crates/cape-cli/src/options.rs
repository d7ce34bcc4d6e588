//! Options that several commands share, and parsers of their values.

use std::{
    path::{Path, PathBuf},
    time::Duration,
};

use burn::tensor::Device;
use cape_core::{MESH_EXTENSIONS, Outfit, SmplModel, parse_device};
use cape_graph::Precision;
use cape_infer::Run;
use clap::{
    Args,
    builder::{PossibleValuesParser, TypedValueParser},
};
use serde::{Deserialize, Serialize};

use crate::{
    console::Console,
    error::{Error, Result},
    files,
};

/// Architectures by name.
pub(crate) const PRESETS: [&str; 5] = ["paper", "detail", "small", "narrow", "tiny"];

/// Options of every command.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Global options")]
pub(crate) struct GlobalArgs {
    /// Device to compute on: flex, ndarray, wgpu[:INDEX] or cuda[:INDEX], if compiled in.
    #[arg(long, global = true, default_value = default_device(), value_name = "NAME")]
    pub(crate) device: String,
    /// Random seed [default: per command].
    #[arg(long, global = true, value_name = "N")]
    pub(crate) seed: Option<u64>,
    /// Print the result on standard output as JSON.
    #[arg(long, global = true)]
    pub(crate) json: bool,
    /// Suppress progress bars and notes.
    #[arg(long, short, global = true)]
    pub(crate) quiet: bool,
    /// Number of CPU threads [default: one per core].
    #[arg(long, global = true, value_name = "N", value_parser = at_least_one)]
    pub(crate) threads: Option<usize>,
}

/// A trained model.
#[derive(Debug, Clone, Args)]
pub(crate) struct RunArgs {
    /// Directory of a trained model, as written by `cape train`, or model file [default: the built-in
    /// model].
    #[arg(value_name = "RUN")]
    run: Option<PathBuf>,
}

/// Held-out frames to work on.
#[derive(Debug, Clone, Args)]
pub(crate) struct DataArgs {
    /// Packed set [default: the one that RUN was trained on].
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
}

/// A directory for results.
#[derive(Debug, Clone, Args)]
pub(crate) struct OutputArgs {
    /// Directory to write; it must be empty or missing.
    #[arg(long, value_name = "DIR")]
    pub(crate) out: PathBuf,
}

/// A directory for results that an interrupted command continues.
#[derive(Debug, Clone, Args)]
pub(crate) struct ResumableOutputArgs {
    /// Directory to write; if it holds results of the same command, they are kept and completed.
    #[arg(long, value_name = "DIR")]
    pub(crate) out: PathBuf,
}

/// A directory of finished results, which belong to settings and inputs.
#[derive(Debug, Clone, Args)]
pub(crate) struct StoreArgs {
    /// Directory to write; finished results of the same settings and inputs are kept.
    #[arg(long, value_name = "DIR")]
    pub(crate) out: PathBuf,
    /// Discard results of other settings, inputs or versions in --out.
    #[arg(long)]
    pub(crate) overwrite: bool,
}

/// Checkpoints by time.
#[derive(Debug, Clone, Copy, Args)]
pub(crate) struct CheckpointArgs {
    /// Minutes between checkpoints within an epoch; 0 saves at the end of epochs only.
    #[arg(long, default_value_t = 15.0, value_name = "M", value_parser = non_negative)]
    checkpoint_minutes: f64,
}

impl CheckpointArgs {
    /// Time between checkpoints within an epoch.
    pub(crate) fn interval(self) -> Option<Duration> {
        let seconds = 60.0 * self.checkpoint_minutes;
        (seconds > 0.0).then(|| Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX))
    }
}

/// Precision of updates.
#[derive(Debug, Clone, Copy, Args)]
pub(crate) struct PrecisionArgs {
    /// Precision of the products of convolutions in updates: f32, or bf16 on processors with AMX or
    /// AVX-512 BF16 [default: f32].
    #[arg(long, value_name = "NAME", value_parser = choices(PRECISIONS))]
    pub precision: Option<Precision>,
}

const PRECISIONS: [(&str, Precision); 2] = [("f32", Precision::F32), ("bf16", Precision::Bf16)];

/// Says where updates are not computed in the precision that was chosen.
pub(crate) fn note_precision(precision: Precision, device: &str, console: Console) {
    if precision == Precision::F32 {
        return;
    }
    if !["flex", "ndarray"].contains(&device) {
        console.note(&format!("bf16 is for processors: products on {device} are computed in f32"));
    } else if precision.instructions().is_none() {
        console
            .note("this processor has neither AMX nor AVX-512 BF16: products are computed in f32");
    }
}

/// Shape of a body.
#[derive(Debug, Clone, Args)]
pub(crate) struct ShapeArgs {
    /// Shape coefficients of the body, β; missing ones are 0.
    #[arg(long, value_delimiter = ',', allow_hyphen_values = true, value_name = "B,B,…")]
    betas: Vec<f32>,
}

/// An outfit.
#[derive(Debug, Clone, Copy, Args)]
pub(crate) struct OutfitArgs {
    /// Outfit of the run, see `cape info RUN` [default: longlong, or the run's first].
    #[arg(long, value_name = "OUTFIT")]
    outfit: Option<Outfit>,
}

/// Kinds of files for bodies and clothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum FileKind {
    Glb,
    Mdd,
    Npz,
    Obj,
    Pc2,
    Ply,
    Png,
    Smpl,
    Usda,
}

/// One outfit, or all of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum OutfitSelection {
    All,
    One(Outfit),
}

impl GlobalArgs {
    pub(crate) fn device(&self) -> Result<Device> {
        Ok(parse_device(&self.device)?)
    }

    /// The seed, 1 if none is given.
    pub(crate) fn seed(&self) -> u64 {
        self.seed.unwrap_or(1)
    }
}

impl RunArgs {
    pub(crate) fn open(&self, global: &GlobalArgs) -> Result<Run> {
        match &self.run {
            Some(path) => Ok(Run::open(path, &global.device()?)?),
            None => Ok(cape_weights::pretrained(&global.device()?)?),
        }
    }

    /// Directory of the run.
    pub(crate) fn directory(&self) -> Result<&Path> {
        match self.run.as_deref() {
            Some(path) if !path.is_file() => Ok(path),
            _ => Err(Error::message("RUN: expected the directory of a trained model")),
        }
    }

    /// The run's path as it was given, or the built-in model's name.
    pub(crate) fn name(&self) -> String {
        self.run
            .as_ref()
            .map_or_else(|| cape_weights::NAME.to_owned(), |path| path.display().to_string())
    }

    /// Takes the argument in the place of RUN if it is something else, so that the built-in model is
    /// meant.
    pub(crate) fn take_other(&mut self) -> Option<PathBuf> {
        // A file of keypoints or a mesh is meant by its name even if it does not exist.
        let named = |path: &PathBuf| {
            let extension = path.extension().and_then(|extension| extension.to_str());
            extension.is_some_and(|own| own == "json" || MESH_EXTENSIONS.contains(&own))
        };
        let other = |path: &PathBuf| {
            let frame = path.to_string_lossy().starts_with("frame:");
            !Run::is_at(path) && (path.exists() || frame || named(path))
        };
        let is_other = self.run.as_ref().is_some_and(other);
        if is_other { self.run.take() } else { None }
    }
}

impl DataArgs {
    /// The packed set's directory.
    pub(crate) fn of(&self, run: &Run) -> Result<PathBuf> {
        match &self.data {
            Some(data) => Ok(data.clone()),
            None => Ok(run.data()?),
        }
    }
}

impl OutputArgs {
    /// Returns an error if there is something already.
    pub(crate) fn require_empty(&self) -> Result {
        files::require_empty(&self.out)
    }
}

impl ShapeArgs {
    /// The coefficients, if any are given.
    pub(crate) fn given(&self) -> Option<&[f32]> {
        (!self.betas.is_empty()).then_some(&self.betas[..])
    }

    /// The coefficients for `body`, which must have that many; empty if none are given.
    pub(crate) fn betas(&self, body: &SmplModel) -> Result<Vec<f32>> {
        let (given, most) = (self.betas.len(), body.betas());
        if given > most {
            return Err(Error::message(format!(
                "--betas: {given} coefficients, but the body has {most}"
            )));
        }
        if let Some(beta) = self.betas.iter().find(|beta| !beta.is_finite()) {
            return Err(Error::message(format!("--betas: {beta} is not a finite number")));
        }
        Ok(self.betas.clone())
    }
}

impl FileKind {
    /// The extension of its files.
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Glb => "glb",
            Self::Mdd => "mdd",
            Self::Npz => "npz",
            Self::Obj => "obj",
            Self::Pc2 => "pc2",
            Self::Ply => "ply",
            Self::Png => "png",
            Self::Smpl => "smpl",
            Self::Usda => "usda",
        }
    }
}

impl OutfitArgs {
    /// The outfit, which `run` must know.
    pub(crate) fn of(&self, run: &Run) -> Result<Outfit> {
        Ok(match self.outfit {
            Some(outfit) => run.outfits().choose(outfit.name())?,
            None => run.default_outfit(),
        })
    }
}

impl OutfitSelection {
    /// Name of the outfit; `None` for all.
    pub(crate) fn name(self) -> Option<String> {
        match self {
            Self::All => None,
            Self::One(outfit) => Some(outfit.to_string()),
        }
    }

    /// The outfits, which `run` must know.
    pub(crate) fn of(self, run: &Run) -> Result<Vec<Outfit>> {
        Ok(match self {
            Self::All => run.outfits().to_vec(),
            Self::One(outfit) => vec![run.outfits().choose(outfit.name())?],
        })
    }
}

/// The default device: the first that is compiled in.
pub(crate) fn default_device() -> &'static str {
    cape_core::DEVICES.first().copied().unwrap_or("flex")
}

/// Parser of a library's values by their names, which help and errors list.
pub(crate) fn choices<T: Clone + Send + Sync + 'static, const N: usize>(
    named: [(&'static str, T); N],
) -> impl TypedValueParser<Value = T> {
    let names = PossibleValuesParser::new(named.each_ref().map(|(name, _)| *name));
    names.try_map(move |text| {
        let value = named.iter().find(|(name, _)| *name == text).map(|(_, value)| value.clone());
        value.ok_or("unknown name")
    })
}

/// Parser of an outfit or of `word`, which stands for all of a run.
pub(crate) fn outfit_or(
    word: &'static str,
) -> impl Fn(&str) -> Result<OutfitSelection, cape_core::Error> + Clone + Send + Sync {
    move |text| {
        if text == word {
            return Ok(OutfitSelection::All);
        }
        text.parse().map(OutfitSelection::One)
    }
}

/// Parser of one of some kinds of files.
pub(crate) fn kinds<const N: usize>(
    kinds: [FileKind; N],
) -> impl TypedValueParser<Value = FileKind> {
    choices(kinds.map(|kind| (kind.name(), kind)))
}

/// Parses a count.
pub(crate) fn at_least_one(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(0) => Err("must be at least 1".into()),
        Ok(count) => Ok(count),
        Err(_) => Err("expected a whole number".into()),
    }
}

/// Parses a finite number above 0.
pub(crate) fn positive(text: &str) -> Result<f64, String> {
    finite(text)?.filter(|&x| x > 0.0).ok_or_else(|| "must be more than 0".into())
}

/// Parses a finite number of at least 0.
pub(crate) fn non_negative(text: &str) -> Result<f64, String> {
    finite(text)?.filter(|&x| x >= 0.0).ok_or_else(|| "must be at least 0".into())
}

/// Parses a number from 0 to 1.
pub(crate) fn share(text: &str) -> Result<f64, String> {
    finite(text)?.filter(|x| (0.0..=1.0).contains(x)).ok_or_else(|| "must be from 0 to 1".into())
}

fn finite(text: &str) -> Result<Option<f64>, String> {
    let number: f64 = text.parse().map_err(|_| "expected a number".to_owned())?;
    if number.is_finite() { Ok(Some(number)) } else { Err("must be finite".into()) }
}

/// Returns an error unless `path` ends in `.extension`.
pub(crate) fn require_extension(option: &str, path: &Path, extension: &str) -> Result {
    if path.extension().is_some_and(|found| found.eq_ignore_ascii_case(extension)) {
        return Ok(());
    }
    Err(Error::message(format!("{option} {}: expected a .{extension} file", path.display())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_checked() {
        assert_eq!(at_least_one("3"), Ok(3));
        assert_eq!(positive("0.5"), Ok(0.5));
        assert_eq!((non_negative("0"), share("1")), (Ok(0.0), Ok(1.0)));
        for parser in [positive, non_negative, share] {
            for text in ["-1", "nan", "inf", "one", ""] {
                assert!(parser(text).is_err(), "{text}");
            }
        }
        assert!(positive("0").is_err() && share("1.1").is_err() && at_least_one("0").is_err());
    }
}
