//! Steps of optimisers, one launch for each vector.

use burn_cubecl::{CubeBackend, kernel::into_contiguous, tensor::CubeTensor};
use cubecl::prelude::*;

use super::{THREADS, elementwise, empty, reduce::row_sum};
use crate::steps::{AdamState, AdamStep, MomentumStep};

/// Largest number of partial sums of a vector.
const PARTS: usize = 256;
/// Least number of values of a partial sum, unless there are fewer.
const PART: usize = 1 << 14;

#[derive(CubeType, CubeLaunch)]
struct Momentum {
    scale: f32,
    momentum: f32,
    rate: f32,
}

#[cube(launch)]
fn momentum_kernel(
    value: &Tensor<f32>,
    gradient: &Tensor<f32>,
    velocity: &Tensor<f32>,
    step: &Momentum,
    new_value: &mut Tensor<f32>,
    new_velocity: &mut Tensor<f32>,
) {
    if ABSOLUTE_POS < new_value.len() {
        let speed = velocity[ABSOLUTE_POS] * step.momentum + gradient[ABSOLUTE_POS] * step.scale;
        new_velocity[ABSOLUTE_POS] = speed;
        new_value[ABSOLUTE_POS] = value[ABSOLUTE_POS] - speed * step.rate;
    }
}

/// [`GraphBackend::momentum_step`](crate::ops::GraphBackend::momentum_step).
pub(super) fn momentum_step(
    value: CubeTensor,
    gradient: CubeTensor,
    velocity: CubeTensor,
    step: MomentumStep,
) -> (CubeTensor, CubeTensor) {
    let [value, gradient, velocity] = [value, gradient, velocity].map(into_contiguous);
    let numbers = [value.meta.num_elements()];
    let (new_value, new_velocity) = (empty(&value, &numbers), empty(&value, &numbers));
    let (count, dim) = elementwise(&new_value);
    momentum_kernel::launch(
        &new_value.client,
        count,
        dim,
        value.into_tensor_arg(),
        gradient.into_tensor_arg(),
        velocity.into_tensor_arg(),
        MomentumLaunch::new(step.scale as f32, step.momentum as f32, step.rate as f32),
        new_value.clone().into_tensor_arg(),
        new_velocity.clone().into_tensor_arg(),
    );
    (new_value, new_velocity)
}

#[derive(CubeType, CubeLaunch)]
struct Adam {
    scale: f32,
    first_decay: f32,
    second_decay: f32,
    first_new: f32,
    second_new: f32,
    first_correction: f32,
    second_correction: f32,
    epsilon: f32,
    rate: f32,
}

#[cube(launch)]
fn adam_kernel(
    gradient: &Tensor<f32>,
    value: &Tensor<f32>,
    first: &Tensor<f32>,
    second: &Tensor<f32>,
    step: &Adam,
    new_value: &mut Tensor<f32>,
    new_first: &mut Tensor<f32>,
    new_second: &mut Tensor<f32>,
) {
    if ABSOLUTE_POS < new_value.len() {
        let g = gradient[ABSOLUTE_POS] * step.scale;
        let m = first[ABSOLUTE_POS] * step.first_decay + g * step.first_new;
        let v = second[ABSOLUTE_POS] * step.second_decay + g * g * step.second_new;
        let deviation = (v / step.second_correction).sqrt() + step.epsilon;
        new_first[ABSOLUTE_POS] = m;
        new_second[ABSOLUTE_POS] = v;
        new_value[ABSOLUTE_POS] =
            value[ABSOLUTE_POS] - m / step.first_correction / deviation * step.rate;
    }
}

/// [`GraphBackend::adam_step`](crate::ops::GraphBackend::adam_step).
pub(super) fn adam_step(
    gradient: CubeTensor,
    state: AdamState<CubeBackend>,
    step: AdamStep,
) -> AdamState<CubeBackend> {
    let AdamState { value, first, second } = state;
    let [gradient, value, first, second] = [gradient, value, first, second].map(into_contiguous);
    let numbers = [value.meta.num_elements()];
    let [new_value, new_first, new_second] = [(); 3].map(|()| empty(&value, &numbers));
    let (count, dim) = elementwise(&new_value);
    let [first_decay, second_decay] = step.decays;
    adam_kernel::launch(
        &new_value.client,
        count,
        dim,
        gradient.into_tensor_arg(),
        value.into_tensor_arg(),
        first.into_tensor_arg(),
        second.into_tensor_arg(),
        AdamLaunch::new(
            step.scale as f32,
            first_decay as f32,
            second_decay as f32,
            (1.0 - first_decay) as f32,
            (1.0 - second_decay) as f32,
            step.corrections[0] as f32,
            step.corrections[1] as f32,
            step.epsilon as f32,
            step.rate as f32,
        ),
        new_value.clone().into_tensor_arg(),
        new_first.clone().into_tensor_arg(),
        new_second.clone().into_tensor_arg(),
    );
    AdamState { value: new_value, first: new_first, second: new_second }
}

/// `out[slot + cube] = Σ x²` over the values `cube · part` to `(cube + 1) · part`, or `Σ x`.
#[cube(launch)]
fn sum_kernel(
    x: &Tensor<f32>,
    out: &mut Tensor<f32>,
    part: usize,
    slot: usize,
    #[comptime] squared: bool,
) {
    let mut shared = Shared::new_slice(THREADS);
    let cube = CUBE_POS_X as usize;
    let end = min((cube + 1) * part, x.len());
    let mut place = cube * part + UNIT_POS_Y as usize;
    let mut sum = 0.0f32;
    while place < end {
        let value = x[place];
        sum += if squared { value * value } else { value };
        place += CUBE_DIM_Y as usize;
    }
    let sum = row_sum(sum, &mut shared);
    if UNIT_POS_Y == 0 {
        out[slot + cube] = sum;
    }
}

/// [`GraphBackend::sum_of_squares`](crate::ops::GraphBackend::sum_of_squares).
pub(super) fn sum_of_squares(x: CubeTensor, sums: CubeTensor, slot: usize) -> CubeTensor {
    let (x, sums) = (into_contiguous(x), into_contiguous(sums));
    // Other tensors may share the memory of the sums.
    let sums = if sums.can_mut() { sums } else { sums.copy() };
    let launch = |x: CubeTensor, out: &CubeTensor, parts: usize, slot: usize, squared: bool| {
        let part = x.meta.num_elements().div_ceil(parts);
        sum_kernel::launch(
            &out.client,
            CubeCount::Static(parts as u32, 1, 1),
            CubeDim::new_2d(1, THREADS as u32),
            x.into_tensor_arg(),
            out.clone().into_tensor_arg(),
            part,
            slot,
            squared,
        );
    };
    let parts = x.meta.num_elements().div_ceil(PART).clamp(1, PARTS);
    if parts == 1 {
        launch(x, &sums, 1, slot, true);
    } else {
        let partial = empty(&x, &[parts]);
        launch(x, &partial, parts, 0, true);
        launch(partial, &sums, 1, slot, false);
    }
    sums
}
