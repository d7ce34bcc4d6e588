//! State of the dashboard.

use std::{path::PathBuf, time::Duration};

use cape_train::{TrainEvent, objective::Losses};

use super::curve::Curve;

/// Steps that curves and times are smoothed over.
const WINDOW: f64 = 20.0;

/// Everything that is shown.
#[derive(Debug, Clone)]
pub(super) struct DashboardState {
    pub(super) title: String,
    pub(super) epochs: usize,
    /// Since the dashboard was started.
    pub(super) elapsed: Duration,
    /// True if losses are drawn on a logarithmic scale.
    pub(super) logarithmic: bool,
    /// True if training stops after the current step.
    pub(super) stopping: bool,
    pub(super) now: Option<CurrentStep>,
    pub(super) validation: Option<ValidationState>,
    pub(super) checkpoint: Option<PathBuf>,
    /// Resident, megabytes: now and at most.
    pub(super) memory: Option<(f64, f64)>,
    pub(super) curves: Curves,
    /// True if a discriminator shows in the losses.
    pub(super) adversarial: bool,
    /// Steps done and time at the first step seen.
    first: Option<(u64, Duration)>,
}

/// The newest step.
#[derive(Debug, Clone, Copy)]
pub(super) struct CurrentStep {
    pub(super) epoch: usize,
    pub(super) step: usize,
    pub(super) steps: usize,
    pub(super) total_step: u64,
    pub(super) losses: Losses,
    pub(super) rate: f64,
}

/// The newest validation, and the best.
#[derive(Debug, Clone, Copy)]
pub(super) struct ValidationState {
    pub(super) millimetres: f64,
    pub(super) active_units: usize,
    /// Millimetres and epoch.
    pub(super) best: (f64, usize),
}

/// Smoothed, by step; validation by epoch and memory by seconds.
#[derive(Debug, Clone)]
pub(super) struct Curves {
    pub(super) reconstruction: Curve,
    pub(super) edge: Curve,
    pub(super) generator: Curve,
    pub(super) discriminator: Curve,
    pub(super) accuracy: Curve,
    pub(super) validation: Curve,
    pub(super) rate: Curve,
    pub(super) seconds: Curve,
    pub(super) memory: Curve,
}

impl DashboardState {
    pub(super) fn new(title: &str, epochs: usize) -> Self {
        let smoothed = || Curve::smoothed(WINDOW);
        let plain = || Curve::smoothed(1.0);
        Self {
            title: title.to_owned(),
            epochs,
            elapsed: Duration::ZERO,
            logarithmic: false,
            stopping: false,
            now: None,
            validation: None,
            checkpoint: None,
            memory: None,
            adversarial: false,
            first: None,
            curves: Curves {
                reconstruction: smoothed(),
                edge: smoothed(),
                generator: smoothed(),
                discriminator: smoothed(),
                accuracy: smoothed(),
                validation: plain(),
                rate: plain(),
                seconds: smoothed(),
                memory: plain(),
            },
        }
    }

    pub(super) fn on_event(&mut self, event: &TrainEvent) {
        match *event {
            TrainEvent::Step { epoch, step, steps, total_step, losses, rate, seconds } => {
                self.first.get_or_insert((total_step, self.elapsed));
                self.adversarial |=
                    losses.gan_discriminator != 0.0 || losses.discriminator_accuracy > 0.0;
                self.now = Some(CurrentStep { epoch, step, steps, total_step, losses, rate });
                let x = total_step as f64;
                let curves = &mut self.curves;
                for (curve, value) in [
                    (&mut curves.reconstruction, losses.reconstruction),
                    (&mut curves.edge, losses.edge),
                    (&mut curves.generator, losses.gan_generator),
                    (&mut curves.discriminator, losses.gan_discriminator),
                    (&mut curves.accuracy, losses.discriminator_accuracy),
                    (&mut curves.rate, rate),
                    (&mut curves.seconds, seconds),
                ] {
                    curve.push(x, value);
                }
            }
            TrainEvent::Validation { epoch, millimetres, active_units, .. } => {
                let best = self.validation.map(|v| v.best).filter(|(best, _)| *best <= millimetres);
                let best = best.unwrap_or((millimetres, epoch));
                self.validation = Some(ValidationState { millimetres, active_units, best });
                self.curves.validation.push(epoch as f64, millimetres);
            }
            TrainEvent::Prior { .. } => {}
            TrainEvent::Checkpoint { ref path } => self.checkpoint = Some(path.clone()),
        }
    }

    /// Takes note of the memory in use.
    pub(super) fn record_memory(&mut self, megabytes: f64) {
        let most = self.memory.map_or(megabytes, |(_, most)| most.max(megabytes));
        self.memory = Some((megabytes, most));
        self.curves.memory.push(self.elapsed.as_secs_f64(), megabytes);
    }

    /// Parts done of all steps and of the epoch's.
    pub(super) fn progress(&self) -> (f64, f64) {
        let Some(now) = self.now else { return (0.0, 0.0) };
        let share = |done: f64, of: usize| (done / of.max(1) as f64).clamp(0.0, 1.0);
        (share(now.total_step as f64, self.epochs * now.steps), share(now.step as f64, now.steps))
    }

    /// Seconds until all steps are done, and the epoch's. The former from the time that went by,
    /// validation and checkpoints included.
    pub(super) fn left(&self) -> Option<(f64, f64)> {
        let now = self.now?;
        let step = self.curves.seconds.last()?;
        let (first, then) = self.first?;
        let seen = now.total_step.saturating_sub(first);
        let all = ((self.epochs * now.steps) as u64).saturating_sub(now.total_step);
        // Time between steps is known from the second epoch on.
        let each = if seen > now.steps as u64 {
            self.elapsed.saturating_sub(then).as_secs_f64() / seen as f64
        } else {
            step
        };
        Some((all as f64 * each, now.steps.saturating_sub(now.step) as f64 * step))
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A training in its third epoch of 60.
    pub(in crate::dashboard) fn busy() -> DashboardState {
        let mut state = DashboardState::new("runs/male", 60);
        let steps = 50;
        for total_step in 1..=120 {
            let x = total_step as f64;
            state.elapsed = Duration::from_millis(500 * total_step);
            let epoch = (total_step as usize - 1) / steps + 1;
            let step = (total_step as usize - 1) % steps + 1;
            state.on_event(&TrainEvent::Step {
                epoch,
                step,
                steps,
                total_step,
                losses: Losses {
                    reconstruction: 0.2 + 1.0 / x,
                    edge: 0.05 + 0.3 / x,
                    kl: 42.0,
                    gan_generator: 0.7 + 0.2 * (x / 9.0).sin(),
                    gan_discriminator: 1.3 - 0.1 * (x / 9.0).sin(),
                    discriminator_accuracy: 0.61,
                    ..Losses::default()
                },
                rate: 8e-3 * (x / 200.0).min(1.0),
                seconds: 0.5,
            });
            state.record_memory(800.0 + x);
            if step == steps {
                let (millimetres, active_units) = (20.0 / epoch as f64, 7);
                let losses = Losses::default();
                let discriminator_accuracy = Some(0.6);
                state.on_event(&TrainEvent::Validation {
                    epoch,
                    losses,
                    millimetres,
                    active_units,
                    discriminator_accuracy,
                });
                state.on_event(&TrainEvent::Checkpoint {
                    path: PathBuf::from(format!("runs/male/checkpoints/step-{total_step:08}")),
                });
            }
        }
        state
    }

    #[test]
    fn progress_and_time_left_follow_the_steps() {
        let state = busy();
        let (all, epoch) = state.progress();
        assert_eq!((all, epoch), (120.0 / 3000.0, 20.0 / 50.0));
        let (all, epoch) = state.left().unwrap();
        assert!((all - 2880.0 * 0.5).abs() < 1e-6 && (epoch - 15.0).abs() < 1e-6, "{all} {epoch}");
        assert_eq!(DashboardState::new("run", 3).left(), None);
    }

    #[test]
    fn the_best_validation_is_kept() {
        let mut state = busy();
        assert_eq!(state.validation.unwrap().best, (10.0, 2));
        state.on_event(&TrainEvent::Validation {
            epoch: 3,
            losses: Losses::default(),
            millimetres: 11.0,
            active_units: 6,
            discriminator_accuracy: None,
        });
        let ValidationState { millimetres, active_units, best } = state.validation.unwrap();
        assert_eq!((millimetres, active_units, best), (11.0, 6, (10.0, 2)));
    }

    #[test]
    fn a_resumed_run_counts_time_from_where_it_goes_on() {
        let mut state = DashboardState::new("run", 10);
        for total_step in 901..=905 {
            state.elapsed = Duration::from_secs(total_step - 901);
            state.on_event(&TrainEvent::Step {
                epoch: 10,
                step: total_step as usize - 900,
                steps: 100,
                total_step,
                losses: Losses::default(),
                rate: 0.0,
                seconds: 1.0,
            });
        }
        let (all, epoch) = state.left().unwrap();
        assert!((all - 95.0).abs() < 1e-9 && (epoch - 95.0).abs() < 1e-9);
        assert!(!state.adversarial);
    }
}
