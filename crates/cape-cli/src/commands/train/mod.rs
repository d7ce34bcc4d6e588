mod processes;
mod self_check;
mod settings;

use std::path::{Path, PathBuf};

use cape_infer::{RunConfig, RunPaths};
use cape_model::CapeConfig;
use cape_train::{TrainOutcome, Trainer, TrainerOptions};
use clap::Args;
use serde::Serialize;

use crate::{
    body_source::BodyFileArgs,
    console::{Console, seconds},
    dashboard::Dashboard,
    error::{Context, Error, Result},
    exit_code::ExitCode,
    interrupt::Interrupt,
    options::{CheckpointArgs, GlobalArgs, PRESETS, default_device, note_precision},
    table::Table,
    training,
};
use processes::Processes;
use self_check::SelfCheckArgs;
use settings::{TrainOverrideArgs, set};

/// Train a model on a packed set.
///
/// Writes configuration, statistics, body, checkpoints, metrics.jsonl and TensorBoard events to a run's
/// directory, from which other commands evaluate, sample and fit. Ctrl-C finishes the step and saves; a
/// second Ctrl-C stops at once.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  cape train --data packed --out runs/narrow --preset narrow --epochs 20\n  \
                        cape train --out runs/narrow --resume\n  \
                        cape train --data packed --preset narrow --check\n  \
                        cape train --data packed --preset narrow --find-rate --out rates"
)]
pub(crate) struct TrainArgs {
    /// Packed set [default with --resume: the run's].
    #[arg(long, value_name = "DIR", required_unless_present = "resume")]
    data: Option<PathBuf>,
    /// Directory of the run: empty or missing, or the one to resume.
    #[arg(long, value_name = "RUN", required_unless_present_any = ["check", "find_rate"])]
    out: Option<PathBuf>,
    /// Resume from the newest checkpoint in --out, or start over if there is none yet.
    #[arg(long, conflicts_with_all = ["body", "gender"])]
    resume: bool,
    #[command(flatten)]
    self_check: SelfCheckArgs,
    /// Configuration, TOML; the options below override it.
    #[arg(long, value_name = "FILE", conflicts_with = "preset")]
    config: Option<PathBuf>,
    /// Architecture; narrow has a quarter of the paper's filters [default: paper].
    #[arg(long, value_name = "NAME", value_parser = PRESETS)]
    preset: Option<String>,
    #[command(flatten)]
    body: BodyFileArgs,
    /// Indices of the clothing vertices, if the packed set has no clothing_verts_idx.npy.
    #[arg(long, value_name = "FILE.npy", conflicts_with = "resume")]
    clothing: Option<PathBuf>,
    #[command(flatten)]
    checkpoints: CheckpointArgs,
    /// Show progress, losses and curves in a full-screen terminal dashboard.
    #[arg(long)]
    tui: bool,
    #[command(flatten)]
    settings: TrainOverrideArgs,
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    #[serde(flatten)]
    outcome: TrainOutcome,
}

impl TrainArgs {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result<ExitCode> {
        let processes = Processes::join()?;
        let result = self.run_in(&processes, global, console);
        processes.end(result)
    }

    fn run_in(
        self,
        processes: &Processes,
        global: &GlobalArgs,
        console: Console,
    ) -> Result<ExitCode> {
        let console = processes.console(console);
        processes.use_threads(global, console)?;
        let device = processes.device(global)?;
        if self.self_check.any() {
            processes.require_one("--check and --find-rate")?;
            return self.run_self_check(global, console, &device);
        }
        if self.tui {
            processes.require_one("--tui")?;
            Dashboard::check()?;
        }
        let world = processes.world();
        let out = self.out.clone().unwrap_or_default();
        let mut trainer = if self.resume {
            processes.in_first(|| self.settle_settings(&out, global))?;
            Trainer::resume_together(&out, self.data.as_deref(), &device, world)
                .doing(|| format!("resuming {}", out.display()))
                .inspect(|trainer| {
                    training::note_damage(trainer, console);
                    if trainer.step() == 0 {
                        console.note("interrupted before its first checkpoint: starts over");
                    }
                })?
        } else {
            let options = TrainerOptions {
                data: self.data.clone().unwrap_or_else(|| out.clone()),
                body: self.body.load()?,
                clothing: self.clothing.clone(),
                config: self.configured(RunConfig::default(), global)?,
            };
            Trainer::create_together(&out, options, &device, world)?
        };
        note_precision(trainer.config().train.precision, &global.device, console);
        trainer.set_checkpoint_interval(self.checkpoints.interval());
        let interrupt = Interrupt::listen(console)?;
        let title = out.to_string_lossy();
        let epochs = trainer.config().train.epochs;
        let dashboard = self.tui.then(|| Dashboard::start(&title, epochs)).transpose()?;
        let outcome = training::run(&mut trainer, console, dashboard, |_| interrupt.was_asked())?;
        let report = Report { out: out.clone(), outcome };
        if processes.is_first() {
            console.result(&report, || report.text())?;
        }
        if report.outcome.finished {
            return Ok(ExitCode::SUCCESS);
        }
        console.note(&format!(
            "interrupted and saved; resume by:\n  {}",
            self.resume_hint(&out, global)
        ));
        Ok(ExitCode::INTERRUPTED)
    }

    /// The configuration: `base` or the file of --config, overridden by preset and options.
    fn configured(&self, base: RunConfig, global: &GlobalArgs) -> Result<RunConfig> {
        let mut config = match &self.config {
            Some(path) => RunConfig::load(path)?,
            None => base,
        };
        if let Some(preset) = &self.preset {
            config.model = CapeConfig::preset(preset)?;
        }
        set(&mut config.train.seed, global.seed);
        self.settings.apply_to(&mut config);
        config.validate()?;
        Ok(config)
    }

    /// Takes settings that change no weight over into the configuration of the run to resume; returns an
    /// error if another option differs from it.
    fn settle_settings(&self, out: &Path, global: &GlobalArgs) -> Result {
        let path = RunPaths::new(out).config();
        let found = RunConfig::load(&path)?;
        let asked = self.configured(found.clone(), global)?;
        let train = found.train.clone().with_record_keeping_of(&asked.train);
        let settled = RunConfig { train, ..found.clone() };
        let Some(difference) = first_difference(&settled, &asked)? else {
            return if settled == found { Ok(()) } else { Ok(settled.save(&path)?) };
        };
        Err(Error::message(format!(
            "{} is of another configuration: {difference}: resume without that option, or choose \
             another --out",
            path.display()
        )))
    }

    /// The command that resumes this training.
    fn resume_hint(&self, out: &Path, global: &GlobalArgs) -> String {
        let mut words = vec!["cape".to_owned(), "train".to_owned()];
        let mut path = |option: &str, path: &Path| {
            words.extend([option.to_owned(), quoted(&path.to_string_lossy())]);
        };
        path("--out", out);
        if let Some(data) = &self.data {
            path("--data", data);
        }
        words.push("--resume".to_owned());
        if global.device != default_device() {
            words.extend(["--device".to_owned(), quoted(&global.device)]);
        }
        if let Some(threads) = global.threads {
            words.extend(["--threads".to_owned(), threads.to_string()]);
        }
        words.join(" ")
    }
}

/// `text` as one word of a shell's command line.
fn quoted(text: &str) -> String {
    let plain = |c: char| c.is_alphanumeric() || "-_./:=+,@%".contains(c);
    if !text.is_empty() && text.chars().all(plain) {
        return text.to_owned();
    }
    format!("'{}'", text.replace('\'', r"'\''"))
}

/// The first setting in which two configurations differ, with both values.
fn first_difference(found: &RunConfig, asked: &RunConfig) -> Result<Option<String>> {
    let table = |config| {
        toml::Value::try_from(config).map_err(|error| Error::message(format!("settings: {error}")))
    };
    Ok(difference("", &table(found)?, &table(asked)?))
}

fn difference(name: &str, found: &toml::Value, asked: &toml::Value) -> Option<String> {
    match (found, asked) {
        (toml::Value::Table(left), toml::Value::Table(right)) => {
            let keys: std::collections::BTreeSet<_> = left.keys().chain(right.keys()).collect();
            keys.into_iter().find_map(|key| {
                let path = if name.is_empty() { key.clone() } else { format!("{name}.{key}") };
                match (left.get(key), right.get(key)) {
                    (Some(left), Some(right)) => difference(&path, left, right),
                    (Some(_), None) => Some(format!("`{path}` is set, but not by the options")),
                    (None, _) => Some(format!("`{path}` is not set, but is by the options")),
                }
            })
        }
        _ => (found != asked).then(|| format!("`{name}` is {found}, but the options say {asked}")),
    }
}

impl Report {
    fn text(&self) -> String {
        let TrainOutcome { epochs, steps, best_validation, seconds: spent, .. } = &self.outcome;
        let mut table = Table::default();
        table.row(["epochs".to_owned(), epochs.to_string()]);
        table.row(["steps".to_owned(), steps.to_string()]);
        let best = best_validation.map_or("–".to_owned(), |mm| format!("{mm:.2} mm"));
        table.row(["best validation error".to_owned(), best]);
        let per_step = spent / (*steps).max(1) as f64;
        table.row(["time".to_owned(), format!("{} ({per_step:.2} s/step)", seconds(*spent))]);
        let out = self.out.display();
        let next = if self.outcome.finished {
            format!(
                "\nnext: cape eval run {out} --data PACKED; cape sample {out} --outfit all --out samples"
            )
        } else {
            String::new()
        };
        format!("{}\n\n{out}{next}", table.text())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_are_named_with_both_values() {
        let found = RunConfig::default();
        assert_eq!(first_difference(&found, &found).unwrap(), None);
        let mut asked = found.clone();
        asked.train.batch = 4;
        let said = first_difference(&found, &asked).unwrap().unwrap();
        assert_eq!(said, "`train.batch` is 16, but the options say 4");
        asked.model.discriminator = None;
        let said = first_difference(&found, &asked).unwrap().unwrap();
        assert_eq!(said, "`model.discriminator` is set, but not by the options");
    }

    #[test]
    fn words_are_quoted_for_a_shell() {
        assert_eq!(quoted("runs/a-1"), "runs/a-1");
        assert_eq!(quoted("my run"), "'my run'");
        assert_eq!(quoted("it's"), r"'it'\''s'");
    }
}
