//! One step of training.

use std::{ops::ControlFlow, time::Instant};

use cape_core::tensors::from_array2;
use cape_data::{Loader, StepBatches};
use cape_infer::{checkpoint, normal, to_device};
use ndarray::s;

use super::{TrainEvent, Trainer};
use crate::{
    Error, Result,
    collective::{StepAgreement, elsewhere, named, sum_step},
    learner::{NonFinite, UpdateOptions},
    log::TrainLog,
    objective::StepInput,
};

impl Trainer {
    /// One update of generator and discriminator; true if training is to stop because `report` broke, in
    /// this step or, of several processes, in the one before.
    pub(super) fn one_step(
        &mut self,
        loader: &mut Loader,
        log: Option<&mut TrainLog>,
        steps: usize,
        report: &mut dyn FnMut(&TrainEvent) -> ControlFlow<()>,
    ) -> Result<bool> {
        let start = Instant::now();
        let step = self.progress.step;
        let train = &self.config.train;
        let rate = train.rate(step, steps);
        let together = self.processes.size() > 1;
        let StepBatches { drawn, generator, encoded, discriminator, state } = loader.step()?;
        let part = self.part();
        let epsilon = self.config.model.variational.then(|| {
            let latent = self.config.model.latent;
            // Shuffles use the first streams of the seed; noise has one per step beyond them.
            let all = normal(train.seed, (1 << 32) + step, drawn.len(), latent);
            let rows = part.read_range(drawn.len());
            if together { all.slice(s![rows, ..]).to_owned() } else { all }
        });
        let input = StepInput {
            frames: to_device(generator, &self.device),
            encoded: encoded.map(|batch| to_device(batch, &self.device)),
            epsilon: epsilon.map(|epsilon| from_array2(epsilon, &self.device)),
            real: discriminator.map(|batch| to_device(batch, &self.device)),
        };
        let logged = (step + 1).is_multiple_of(train.log_steps as u64);
        let options =
            UpdateOptions { rate, kl_share: train.kl_share(step, steps), detailed: logged };
        let mut evaluation = self.learner.evaluate(&input, options.kl_share);
        let agreed = if together {
            // Without a row of its own a process evaluates the first one, which does not count.
            let share = part.range(drawn.len()).len() as f32 / drawn.len() as f32;
            let model = self.learner.model();
            Some(sum_step(&*self.processes, model, &mut evaluation, share, self.stop_asked)?)
        } else {
            None
        };
        let update = match self.learner.apply(&evaluation, options) {
            Ok(update) => update,
            Err(error) => return Err(self.not_finite(error, &drawn, agreed.as_ref())?),
        };
        let losses = update.losses;
        self.progress.accuracy_sum.0 += losses.discriminator_accuracy as f32;
        self.progress.accuracy_sum.1 += 1;
        self.progress.step += 1;
        self.progress.loader = state;

        let seconds = start.elapsed().as_secs_f64();
        self.progress.seconds += seconds;
        let (epoch, step) =
            ((step / steps as u64) as usize + 1, (step % steps as u64) as usize + 1);
        if let Some(log) = log.filter(|_| logged) {
            log.step(self.progress.step, epoch, &update, rate, seconds)?;
        }
        let total_step = self.progress.step;
        let event = TrainEvent::Step { epoch, step, steps, total_step, losses, rate, seconds };
        self.stop_asked |= report(&event).is_break();
        Ok(agreed.map_or(self.stop_asked, |agreed| agreed.stop))
    }

    /// The error of a step with a loss or gradient that is not finite.
    fn not_finite(
        &self,
        error: NonFinite,
        frames: &[usize],
        agreed: Option<&StepAgreement>,
    ) -> Result<Error> {
        if self.processes.rank() != 0 {
            return Ok(elsewhere(&[0]));
        }
        let kept = checkpoint::list(&self.paths.checkpoints())?.pop();
        let kept = kept.map_or_else(
            || "there is no checkpoint yet".to_owned(),
            |(_, path)| format!("the last checkpoint is {}", path.display()),
        );
        let at = agreed
            .filter(|agreed| !agreed.non_finite.is_empty())
            .map_or_else(String::new, |agreed| format!(" in {}", named(&agreed.non_finite)));
        Ok(Error::data(format!(
            "{error}{at} at step {} (training frames {frames:?}); {kept}; a lower train.peak_rate may \
             help",
            self.progress.step + 1,
        )))
    }
}
