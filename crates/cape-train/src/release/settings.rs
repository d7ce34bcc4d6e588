//! Configuration files of the release: flat YAML, `key: value`.

use std::{collections::BTreeMap, fs, path::Path};

use cape_model::{CapeConfig, LossConfig};
use yaml_rust2::{Event, parser::Parser};

use crate::{Error, Result};
use cape_infer::RunConfig;

/// Largest size of a configuration file, bytes.
const MAX_FILE: u64 = 1 << 20;

/// A value: a scalar or a list of scalars.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Value {
    Text(String),
    List(Vec<String>),
}

/// Keys and values of a configuration file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Settings {
    values: BTreeMap<String, Value>,
    used: Vec<&'static str>,
}

impl Settings {
    pub(super) fn load(path: &Path) -> Result<Self> {
        let length = fs::metadata(path).map_err(|source| Error::io(path, source))?.len();
        if length > MAX_FILE {
            return Err(Error::format(
                path,
                format!("{length} bytes, expected a configuration file of at most {MAX_FILE}"),
            ));
        }
        let text = fs::read_to_string(path).map_err(|source| Error::io(path, source))?;
        Self::parse(&text).map_err(|message| Error::format(path, message))
    }

    fn parse(text: &str) -> Result<Self, String> {
        let mut parser = Parser::new_from_str(text);
        let mut next = || match parser.next_token() {
            Ok((event, _)) => Ok(event),
            Err(error) => Err(error.to_string()),
        };
        let nested = || "expected flat `key: value` lines without nested values".to_owned();
        let mut values = BTreeMap::new();
        loop {
            match next()? {
                Event::MappingStart(..) => break,
                Event::StreamEnd => return Ok(Self { values, used: Vec::new() }),
                Event::StreamStart | Event::DocumentStart | Event::DocumentEnd | Event::Nothing => {
                }
                _ => return Err(nested()),
            }
        }
        loop {
            let key = match next()? {
                Event::Scalar(key, ..) => key,
                Event::MappingEnd => return Ok(Self { values, used: Vec::new() }),
                _ => return Err(nested()),
            };
            let value = match next()? {
                Event::Scalar(text, ..) => Value::Text(text),
                Event::SequenceStart(..) => {
                    let mut list = Vec::new();
                    loop {
                        match next()? {
                            Event::Scalar(text, ..) => list.push(text),
                            Event::SequenceEnd => break Value::List(list),
                            _ => return Err(format!("`{key}`: {}", nested())),
                        }
                    }
                }
                _ => return Err(format!("`{key}`: {}", nested())),
            };
            values.insert(key, value);
        }
    }

    /// Value of the first of `keys` that exists.
    fn take(&mut self, keys: &[&'static str]) -> Option<(&'static str, Value)> {
        let key = keys.iter().find(|&&key| self.values.contains_key(key))?;
        self.used.push(key);
        Some((key, self.values[*key].clone()))
    }

    fn number(&mut self, keys: &[&'static str]) -> Result<Option<(&'static str, f64)>, String> {
        let Some((key, value)) = self.take(keys) else { return Ok(None) };
        let number = match &value {
            Value::Text(text) => text.parse().ok().filter(|x: &f64| x.is_finite()),
            Value::List(_) => None,
        };
        match number {
            Some(number) => Ok(Some((key, number))),
            None => Err(format!("`{key}`: expected a number")),
        }
    }

    fn list(&mut self, keys: &[&'static str]) -> Result<Option<(&'static str, Vec<u32>)>, String> {
        let Some((key, value)) = self.take(keys) else { return Ok(None) };
        let texts: Vec<String> = match value {
            Value::List(list) => list,
            Value::Text(text) => text
                .trim_matches(['[', ']', '(', ')'])
                .split([',', ' '])
                .filter(|part| !part.is_empty())
                .map(str::to_owned)
                .collect(),
        };
        let numbers: Option<Vec<u32>> = texts.iter().map(|text| text.trim().parse().ok()).collect();
        match numbers {
            Some(numbers) => Ok(Some((key, numbers))),
            None => Err(format!("`{key}`: expected a list of whole numbers")),
        }
    }

    /// Checks the settings of the architecture against `config` and takes over the others.
    pub(super) fn apply(&mut self, config: &mut RunConfig) -> Result<(), String> {
        if let Some((_, factors)) = self.list(&["factors_g", "factors", "ds_factors"])? {
            config.model.factors = factors;
        }
        if let Some((_, factors)) = self.list(&["factors_d"])?
            && let Some(discriminator) = &mut config.model.discriminator
        {
            discriminator.factors = factors;
        }
        self.check_model(&config.model)?;
        self.take_loss(&mut config.loss)?;
        let train = &mut config.train;
        for (keys, slot) in [
            (&["epochs", "num_epochs"] as &[&'static str], &mut train.epochs),
            (&["batch", "batch_size"], &mut train.batch),
        ] {
            if let Some((key, number)) = self.number(keys)? {
                *slot = whole(key, number)?;
            }
        }
        if let Some((key, number)) = self.number(&["seed"])? {
            train.seed = whole(key, number)? as u64;
        }
        for (keys, slot) in [
            (&["lr", "learning_rate"] as &[&'static str], &mut train.peak_rate),
            (&["momentum"], &mut train.momentum),
        ] {
            if let Some((_, number)) = self.number(keys)? {
                *slot = number;
            }
        }
        Ok(())
    }

    fn check_model(&mut self, model: &CapeConfig) -> Result<(), String> {
        for (key, found) in [
            ("nf", model.filters.first().copied().unwrap_or(0)),
            ("K", model.order),
            ("nz", model.latent),
            ("nz_cond", model.pose_embedding),
            ("nz_cond2", model.outfit_embedding),
            ("reduce_dim", model.reduce),
            ("Kd", model.discriminator.as_ref().map_or(0, |d| d.order)),
        ] {
            if let Some((_, number)) = self.number(&[key])?
                && number != found as f64
            {
                return Err(format!(
                    "`{key}` is {number}, but the weights of the checkpoint have {found}"
                ));
            }
        }
        if let Some((_, filters)) = self.list(&["F"])? {
            let found: Vec<u32> = model.filters.iter().map(|&f| f as u32).collect();
            if filters != found {
                return Err(format!(
                    "`F` is {filters:?}, but the weights of the checkpoint have {found:?}"
                ));
            }
        }
        Ok(())
    }

    fn take_loss(&mut self, loss: &mut LossConfig) -> Result<(), String> {
        for (keys, slot) in [
            (&["lambda_recon"] as &[&'static str], &mut loss.reconstruction),
            (&["lambda_edge"], &mut loss.edge),
            (&["lambda_kl", "lambda_latent"], &mut loss.kl),
            (&["lambda_gan"], &mut loss.gan),
            (&["label_smoothing"], &mut loss.label_smoothing),
            (&["regularization_effective"], &mut loss.regularisation),
        ] {
            if let Some((_, number)) = self.number(keys)? {
                *slot = number;
            }
        }
        Ok(())
    }

    /// Keys that were not used.
    pub(super) fn unused(&self) -> Vec<String> {
        let used = |key: &&String| self.used.iter().any(|used| used == key);
        self.values.keys().filter(|key| !used(key)).cloned().collect()
    }
}

fn whole(key: &str, number: f64) -> Result<usize, String> {
    if number >= 0.0 && number.fract() == 0.0 && number < 1e9 {
        return Ok(number as usize);
    }
    Err(format!("`{key}`: expected a whole number, not {number}"))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn settings_are_taken_and_checked() {
        let text = "# CAPE\nname: some_run\nnf: 64\nnz: 18\nF: [64, 64, 128, 128, 256, 256, 512, 512]\n\
                    factors_g: '1,2,1,2,1,2,1,1'\nlambda_gan: 0.05\nlr: 4e-3\nseed: 3\n";
        let mut settings = Settings::parse(text).unwrap();
        let mut config = RunConfig::default();
        settings.apply(&mut config).unwrap();
        assert_eq!((config.loss.gan, config.train.peak_rate, config.train.seed), (0.05, 4e-3, 3));
        assert_eq!(config.model, CapeConfig::paper());
        assert_eq!(settings.unused(), ["name"]);
        for (text, expected) in [
            ("nz: 64\n", "`nz` is 64, but the weights of the checkpoint have 18"),
            ("F: [1, 2]\n", "`F` is [1, 2]"),
            ("lr: fast\n", "`lr`: expected a number"),
            ("seed: 1.5\n", "`seed`: expected a whole number"),
            ("factors: [a]\n", "`factors`: expected a list"),
        ] {
            let message = Settings::parse(text).unwrap().apply(&mut config).unwrap_err();
            assert!(message.contains(expected), "{message}");
        }
    }

    #[test]
    fn what_is_not_flat_is_refused() {
        for text in ["a:\n  b: 1\n", "- 1\n", "a: [[1]]\n", "a: &x 1\nb: *x\n", "a: 'b\n", "a: [1"]
        {
            assert!(Settings::parse(text).is_err(), "{text}");
        }
        assert!(Settings::parse("").unwrap().values.is_empty());
    }

    proptest! {
        #[test]
        fn no_text_makes_the_reader_panic(text in "[a-z0-9:\\-\\[\\]{}&*!|>'\"%@`, #\n\t?]{0,80}") {
            let _ = Settings::parse(&text);
        }

        #[test]
        fn no_characters_make_the_reader_panic(text: String) {
            let _ = Settings::parse(&text);
        }
    }
}
