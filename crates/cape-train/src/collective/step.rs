//! The sum of a step, and the comparison of weights.

use burn::{
    module::Module,
    tensor::{Device, Gradients, Tensor, TensorData},
};
use cape_core::tensors::to_host;
use cape_model::{Cape, weights::for_each_parameter};

use super::{Collective, elsewhere, named, raised, ranks_where};
use crate::{
    Error, Result,
    objective::{Evaluation, Losses},
};

/// Decisions common to all processes after the sum of a step.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct StepAgreement {
    /// True if a process asked to stop.
    pub(crate) stop: bool,
    /// Processes in whose part a loss or gradient is not finite.
    pub(crate) non_finite: Vec<usize>,
}

/// Replaces losses and gradients of a part of a batch by those of the whole batch: their sums over the
/// processes, weighted by the `share` of the batch that each part is, 0 to 1.
///
/// Parameters are in the order of the model, which is the same in every process.
pub(crate) fn sum_step(
    processes: &dyn Collective,
    model: &Cape,
    evaluation: &mut Evaluation,
    share: f32,
    stop: bool,
) -> Result<StepAgreement> {
    let Cape { generator, discriminator } = model;
    let mut values = collect(generator, &evaluation.generator);
    let generator_values = values.len();
    let opponent = discriminator.as_ref().zip(evaluation.discriminator.as_mut());
    if let Some((discriminator, gradients)) = &opponent {
        values.extend(collect(*discriminator, gradients));
    }
    let gradient_values = values.len();
    values.extend(evaluation.losses.named_values().map(|(_, value)| value as f32));
    let finite = share == 0.0 || values.iter().all(|value| value.is_finite());
    if share == 0.0 {
        // What is not finite stays so when it is multiplied by 0.
        values.fill(0.0);
    }
    for value in &mut values {
        *value *= share;
    }
    let flags = values.len();
    values.resize(flags + processes.size() + 1, 0.0);
    values[flags + processes.rank()] = f32::from(u8::from(!finite));
    values[flags + processes.size()] = f32::from(u8::from(stop));

    processes.sum(&mut values)?;

    distribute(generator, &mut evaluation.generator, &values[..generator_values]);
    if let Some((discriminator, gradients)) = opponent {
        distribute(discriminator, gradients, &values[generator_values..gradient_values]);
    }
    evaluation.losses = Losses::from_values(values[gradient_values..flags].iter().copied());
    let (non_finite, stop) = values[flags..].split_at(processes.size());
    Ok(StepAgreement { stop: !raised(stop).is_empty(), non_finite: raised(non_finite) })
}

/// Gradients of all parameters that have one, in the order of the module.
fn collect<M: Module>(module: &M, gradients: &Gradients) -> Vec<f32> {
    let mut found = Vec::new();
    for_each_parameter(module, |parameter| found.extend(parameter.gradient(gradients)));
    if found.is_empty() { Vec::new() } else { to_host(Tensor::cat(found, 0)) }
}

/// Replaces the gradients of all parameters that have one, in the order of the module.
fn distribute<M: Module>(module: &M, gradients: &mut Gradients, values: &[f32]) {
    let mut all = None;
    let mut start = 0;
    for_each_parameter(module, |parameter| {
        if parameter.gradient(gradients).is_none() {
            return;
        }
        let all = all.get_or_insert_with(|| upload(values, &parameter.device().inner()));
        let end = start + parameter.shape.iter().product::<usize>();
        parameter.replace_gradient(gradients, all.clone().narrow(0, start, end - start));
        start = end;
    });
}

fn upload(values: &[f32], device: &Device) -> Tensor<1> {
    Tensor::from_data(TensorData::new(values.to_vec(), [values.len()]), device)
}

/// Compares names, shapes and values of the weights of all processes with those of process 0.
///
/// # Errors
/// In all processes if they differ in one.
pub(crate) fn require_same_weights(
    processes: &dyn Collective,
    model: &Cape,
    step: u64,
) -> Result<()> {
    if processes.size() == 1 {
        return Ok(());
    }
    let own = checksum(model).to_le_bytes();
    let mut first = own;
    processes.broadcast(&mut first)?;
    let different = ranks_where(processes, own != first)?;
    if different.is_empty() {
        return Ok(());
    }
    if processes.rank() != 0 {
        return Err(elsewhere(&[0]));
    }
    Err(Error::data(format!(
        "the weights of {} differ from those of process 0 at step {step}: the processes must run the same \
         program on processors or cards of one kind; resume from the last checkpoint",
        named(&different)
    )))
}

/// CRC-32C of the names, shapes and values of all parameters.
fn checksum(model: &Cape) -> u32 {
    let mut sum = 0;
    for_each_parameter(model, |parameter| {
        let shape = format!("{} {:?}", parameter.path, parameter.shape);
        sum = crc32c::crc32c_append(sum, shape.as_bytes());
        let bytes: Vec<u8> = parameter.read().into_iter().flat_map(f32::to_le_bytes).collect();
        sum = crc32c::crc32c_append(sum, &bytes);
    });
    sum
}
