//! Latent codes given on the command line.

use std::{fs, path::Path};

use cape_core::{Outfit, npy::read_f64};
use cape_data::Split;
use cape_infer::Run;
use serde::Deserialize;

use crate::{
    console::Console,
    error::{Error, Result},
    priors::PriorArgs,
};

/// Model and prior for codes of the command line.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LatentSampler<'a> {
    pub(crate) run: &'a Run,
    pub(crate) drawn: PriorArgs,
    pub(crate) outfit: Outfit,
    pub(crate) console: Console,
}

/// A latent code, `[latent]`.
pub(crate) type Code = Vec<f32>;

#[derive(Deserialize)]
struct CodeLine {
    code: Vec<f32>,
    outfit: Option<Outfit>,
}

impl LatentSampler<'_> {
    /// The code named by `text`: `mean` (zeros); `seed:N`, sampled; `frame:K`, of a test frame of the
    /// run; or row `:ROW` of a .npy file of `[latent]` or `[n, latent]`, or of samples.jsonl.
    pub(crate) fn code(&self, text: &str) -> Result<Code> {
        let latent = self.run.config().model.latent;
        let code = if text == "mean" {
            vec![0.0; latent]
        } else if let Some(seed) = text.strip_prefix("seed:") {
            let seed = number(text, seed)?;
            let &Self { run, drawn, outfit, console } = self;
            drawn.codes(run, &[outfit], 1, seed, console)?.row(0).to_vec()
        } else if let Some(frame) = text.strip_prefix("frame:") {
            let set = self.run.open_set(self.run.data()?, Split::Test)?;
            self.run.encode_frames(&set, &[number(text, frame)? as usize])?.row(0).to_vec()
        } else {
            from_file(text)?
        };
        if code.len() != latent || code.iter().any(|x| !x.is_finite()) {
            return Err(Error::message(format!(
                "{text}: code has {} values, expected {latent} finite ones",
                code.len()
            )));
        }
        Ok(code)
    }

    /// Outfit of the code named by `text`: that of a frame or of a line of samples.jsonl, else the one that
    /// codes are sampled for.
    pub(crate) fn outfit_of(&self, text: &str) -> Result<Outfit> {
        if let Some(frame) = text.strip_prefix("frame:") {
            let set = self.run.open_set(self.run.data()?, Split::Test)?;
            let outfit = set.outfits().get(number(text, frame)? as usize);
            return Ok(outfit.copied().unwrap_or(self.outfit));
        }
        let (path, row) = path_and_row(text)?;
        if is_lines(path) {
            return Ok(line_of(path, row)?.outfit.unwrap_or(self.outfit));
        }
        Ok(self.outfit)
    }

    /// The sum of codes given by a text such as `frame:3 - frame:10 + seed:1`, and its terms.
    pub(crate) fn sum(&self, text: &str) -> Result<(Code, Vec<(String, Code)>)> {
        let mut sum = vec![0.0; self.run.config().model.latent];
        let mut terms = Vec::new();
        let mut sign = 1.0;
        let mut expects_term = true;
        for word in text.split_whitespace() {
            match (word, expects_term) {
                ("+" | "-", false) => sign = if word == "+" { 1.0 } else { -1.0 },
                ("+" | "-", true) | (_, false) => return Err(malformed(text)),
                (name, true) => {
                    let code = self.code(name)?;
                    sum.iter_mut().zip(&code).for_each(|(sum, x)| *sum += sign * x);
                    terms.push((
                        if sign > 0.0 { name.to_owned() } else { format!("- {name}") },
                        code,
                    ));
                }
            }
            expects_term = !expects_term;
        }
        if expects_term { Err(malformed(text)) } else { Ok((sum, terms)) }
    }
}

fn malformed(text: &str) -> Error {
    Error::message(format!(
        "`{text}`: expected codes with + or - and spaces between them, such as `frame:3 - frame:10 + seed:1`"
    ))
}

fn number(text: &str, digits: &str) -> Result<u64> {
    digits
        .parse()
        .map_err(|_| Error::message(format!("`{text}`: expected a whole number after the colon")))
}

fn path_and_row(text: &str) -> Result<(&Path, usize)> {
    Ok(match text.rsplit_once(':') {
        Some((path, row)) if !row.is_empty() && row.bytes().all(|b| b.is_ascii_digit()) => {
            (Path::new(path), number(text, row)? as usize)
        }
        _ => (Path::new(text), 0),
    })
}

fn is_lines(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("jsonl"))
}

fn missing(path: &Path, row: usize, rows: usize) -> Error {
    Error::message(format!("{}: no row {row}: the file has {rows} rows", path.display()))
}

fn line_of(path: &Path, row: usize) -> Result<CodeLine> {
    let lines = fs::read_to_string(path).map_err(|error| Error::io(path, error))?;
    let line = lines.lines().nth(row).ok_or_else(|| missing(path, row, lines.lines().count()))?;
    Ok(serde_json::from_str(line).map_err(|error| {
        cape_core::Error::field(path, format!("line {}", row + 1), error.to_string())
    })?)
}

fn from_file(text: &str) -> Result<Vec<f32>> {
    let (path, row) = path_and_row(text)?;
    if is_lines(path) {
        return Ok(line_of(path, row)?.code);
    }
    let extension = path.extension().unwrap_or_default();
    if !extension.eq_ignore_ascii_case("npy") {
        return Err(Error::message(format!(
            "unknown code `{text}`: expected mean, seed:N, frame:K, FILE.npy:ROW or FILE.jsonl:ROW"
        )));
    }
    let array = read_f64(path)?;
    let width = array.shape().last().copied().unwrap_or(0).max(1);
    let values: Vec<f32> = array.iter().map(|&x| x as f32).collect();
    let rows = values.chunks_exact(width);
    let count = rows.len();
    rows.into_iter().nth(row).map(<[f32]>::to_vec).ok_or_else(|| missing(path, row, count))
}
