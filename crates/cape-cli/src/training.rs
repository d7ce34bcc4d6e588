//! Training as it is watched: a bar for each epoch, a line at its end.

use std::ops::ControlFlow;

use cape_train::{Event, Outcome, Trainer, objective::Losses};
use indicatif::ProgressBar;

use crate::{
    console::{Console, seconds},
    error::Result,
};

/// Trains until the end, or until `stop` says so after a step.
pub(crate) fn run(
    trainer: &mut Trainer,
    console: Console,
    mut stop: impl FnMut(&Event) -> bool,
) -> Result<Outcome> {
    let epochs = trainer.config().train.epochs;
    let mut watch = Watch::new(console, epochs);
    let outcome = trainer.run(&mut |event| {
        watch.see(event);
        if stop(event) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    });
    watch.bar.finish_and_clear();
    Ok(outcome?)
}

struct Watch {
    console: Console,
    epochs: usize,
    bar: ProgressBar,
    /// Of the current epoch: steps seen, their losses and seconds added up.
    seen: usize,
    reconstruction: f64,
    edge: f64,
    spent: f64,
}

impl Watch {
    fn new(console: Console, epochs: usize) -> Self {
        let bar = console.bar("train", "steps");
        Self { console, epochs, bar, seen: 0, reconstruction: 0.0, edge: 0.0, spent: 0.0 }
    }

    fn see(&mut self, event: &Event) {
        match event {
            Event::Step { epoch, step, steps, losses, seconds, .. } => {
                self.step(*epoch, *step, *steps, losses, *seconds);
            }
            Event::Validation {
                epoch,
                millimetres,
                active_units,
                discriminator_accuracy,
                ..
            } => {
                let mut line = self.line(*epoch, Some(*millimetres));
                line += &format!("  {active_units} active");
                if let Some(accuracy) = discriminator_accuracy {
                    line += &format!("  D right {:.0} %", 100.0 * accuracy);
                }
                self.say(&line);
            }
            Event::Checkpoint { .. } => {}
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
            "rec {:.3} edge {:.3} kl {:.1} gan {:.2}/{:.2} · all done in {}",
            losses.reconstruction,
            losses.edge,
            losses.kl,
            losses.gan_generator,
            losses.gan_discriminator,
            seconds(left as f64 * self.spent / self.seen as f64),
        ));
    }

    /// What an epoch came to.
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

    fn say(&self, line: &str) {
        if self.console.shows_bars() {
            self.bar.println(line);
        } else {
            self.console.note(line);
        }
    }
}
