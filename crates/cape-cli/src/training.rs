//! Progress of training: a bar per epoch, a line at its end.

use std::ops::ControlFlow;

use cape_core::{Mesh, SmplModel};
use cape_render::{Object, Style, Tile, View, contact_sheet, portrait};
use cape_train::{
    Preview, PreviewFn, TensorBoardImage, TrainEvent, TrainOutcome, Trainer, objective::Losses,
};
use indicatif::ProgressBar;

use crate::{
    console::{Console, seconds},
    dashboard::Dashboard,
    error::Result,
};

/// Trains until the end, or until `stop` returns true after a step.
pub(crate) fn run(
    trainer: &mut Trainer,
    console: Console,
    mut dashboard: Option<Dashboard>,
    mut stop: impl FnMut(&TrainEvent) -> bool,
) -> Result<TrainOutcome> {
    let epochs = trainer.config().train.epochs;
    trainer.set_preview_fn(preview_fn(SmplModel::load(trainer.paths().body())?.mesh()));
    let mut watch = EpochDisplay::new(console, epochs);
    let outcome = trainer.run(&mut |event| {
        let mut over = stop(event);
        if let Some(dashboard) = &mut dashboard {
            dashboard.on_event(event);
            over |= dashboard.asked_to_stop();
        } else {
            watch.on_event(event);
        }
        if over { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    });
    watch.bar.finish_and_clear();
    Ok(outcome?)
}

/// Names the checkpoints that were passed over in resuming.
pub(crate) fn note_damage(trainer: &Trainer, console: Console) {
    for damaged in trainer.damaged_checkpoints() {
        console.note(&format!(
            "{}; kept as {}, resumes from step {}",
            damaged.reason,
            damaged.path.display(),
            trainer.step()
        ));
    }
}

/// Pictures of frames and their reconstructions on the rest body. A picture that cannot be drawn is
/// left out, so that training continues.
fn preview_fn(body: Mesh) -> PreviewFn {
    Box::new(move |previews| {
        let style = Style { width: 240, height: 300, ..Style::default() };
        let dressed = |displacement: &[f32]| {
            let mut mesh = body.clone();
            for (vertex, moved) in mesh.vertices.iter_mut().zip(displacement.chunks_exact(3)) {
                for (at, by) in vertex.iter_mut().zip(moved) {
                    *at += by;
                }
            }
            portrait(Object::new(&mesh), View::ThreeQuarter, &style)
        };
        let mut tiles = Vec::new();
        for Preview { outfit, truth, predicted } in previews {
            for (what, displacement) in [("", truth), (", reconstructed", predicted)] {
                let Ok(image) = dressed(displacement) else { return Vec::new() };
                tiles.push(Tile { image, label: format!("{outfit}{what}") });
            }
        }
        let mut png = Vec::new();
        let Ok(sheet) = contact_sheet(&tiles, 4, None) else { return Vec::new() };
        if sheet.encode(&mut png).is_err() {
            return Vec::new();
        }
        let (width, height) = (sheet.width(), sheet.height());
        vec![TensorBoardImage { tag: "validation/reconstructions".into(), width, height, png }]
    })
}

struct EpochDisplay {
    console: Console,
    epochs: usize,
    bar: ProgressBar,
    /// Number of steps of the current epoch so far; sums of their losses and seconds follow.
    seen: usize,
    reconstruction: f64,
    edge: f64,
    spent: f64,
}

impl EpochDisplay {
    fn new(console: Console, epochs: usize) -> Self {
        let bar = console.bar("train", "steps");
        Self { console, epochs, bar, seen: 0, reconstruction: 0.0, edge: 0.0, spent: 0.0 }
    }

    fn on_event(&mut self, event: &TrainEvent) {
        match event {
            TrainEvent::Step { epoch, step, steps, losses, seconds, .. } => {
                self.step(*epoch, *step, *steps, losses, *seconds);
            }
            TrainEvent::Validation {
                epoch,
                millimetres,
                active_units,
                discriminator_accuracy,
                ..
            } => {
                let line = self.line(*epoch, Some(*millimetres));
                let accuracy = discriminator_accuracy
                    .map_or(String::new(), |share| format!("  D accuracy {:.0} %", 100.0 * share));
                self.print_line(&format!("{line}  {active_units} active dimensions{accuracy}"));
            }
            TrainEvent::Prior { done, total } => {
                if *done >= *total {
                    self.print_line(&format!(
                        "prior fitted to the codes of {total} training frames"
                    ));
                }
                self.bar.set_prefix("prior");
                self.bar.set_message("");
                self.bar.set_length(*total as u64);
                self.bar.set_position(*done as u64);
            }
            TrainEvent::Checkpoint { .. } => {}
        }
    }

    fn step(&mut self, epoch: usize, step: usize, steps: usize, losses: &Losses, spent: f64) {
        if step == 1 || self.seen == 0 {
            self.bar.reset();
            self.bar.set_length(steps as u64);
            self.bar.set_prefix(format!("epoch {epoch}/{}", self.epochs));
            (self.seen, self.reconstruction, self.edge, self.spent) = (0, 0.0, 0.0, 0.0);
        }
        self.seen += 1;
        self.reconstruction += losses.reconstruction;
        self.edge += losses.edge;
        self.spent += spent;
        self.bar.set_position(step as u64);
        let left = (self.epochs - epoch.min(self.epochs)) * steps + steps - step.min(steps);
        self.bar.set_message(format!(
            "rec {:.3} edge {:.3} kl {:.1} gan {:.2}/{:.2} · {} left in total",
            losses.reconstruction,
            losses.edge,
            losses.kl,
            losses.gan_generator,
            losses.gan_discriminator,
            seconds(left as f64 * self.spent / self.seen as f64),
        ));
    }

    /// Mean losses of an epoch.
    fn line(&self, epoch: usize, validation: Option<f64>) -> String {
        let count = self.seen.max(1) as f64;
        let validation = validation.map_or(String::new(), |mm| format!("  validation {mm:6.2} mm"));
        format!(
            "epoch {epoch:>3}/{}  rec {:.4}  edge {:.4}{validation}  {:.2} s/step",
            self.epochs,
            self.reconstruction / count,
            self.edge / count,
            self.spent / count,
        )
    }

    fn print_line(&self, line: &str) {
        if self.console.shows_bars() {
            self.bar.println(line);
        } else {
            self.console.note(line);
        }
    }
}
