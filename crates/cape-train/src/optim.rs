//! Gradient descent with momentum and Adam, with clipping by the global norm.
//!
//! burn-optim 0.22 is not used because it clips every parameter on its own, keeps the velocity of
//! its momentum private and its state under random parameter identities, whereas checkpoints and
//! imports need it under parameter paths, and computes Adam's bias correction in f32.

use std::collections::BTreeMap;

use burn::{
    module::Module,
    tensor::{Gradients, Tensor, TensorData},
};
use cape_model::weights::{HostArray, Weights, for_each_parameter, map_parameters};

use crate::{Error, Result};
use cape_core::tensors::to_host;
use cape_graph::{AdamStep, MomentumStep, adam_step, momentum_step, sums_of_squares};
use cape_infer::OptimiserKind;

/// Suffix of the names of second moments in [`Optimiser::state`].
const SECOND: &str = ".second_moment";
/// Name of the number of Adam's steps in [`Optimiser::state`].
const STEPS: &str = "steps";
/// Adam's β₂ and ε.
const SECOND_DECAY: f64 = 0.999;
const EPSILON: f64 = 1e-8;

/// Optimiser with its state: one moment per parameter for momentum, two for Adam.
///
/// ```
/// use burn::tensor::{Device, Tensor};
/// use cape_model::{Initialiser, weights::collect};
/// use cape_infer::OptimiserKind;
/// use cape_train::optim::{Optimiser, global_norm};
///
/// let device = Device::default().autodiff();
/// let layer = Initialiser::new(1, 0.1, &device).linear(1, 1);
/// // The gradient of w x + b at x = 1 is (1, 1).
/// let gradients = layer.forward(Tensor::<2>::ones([1, 1], &device)).sum().backward();
/// let norm = global_norm(&layer, &gradients);
/// assert!((norm - 2f64.sqrt()).abs() < 1e-6);
/// let mut optimiser = Optimiser::new(OptimiserKind::Sgd, 0.9, 5.0);
/// let layer = optimiser.step(layer, &gradients, norm, 0.25);
/// assert_eq!(collect(&layer)["bias"].values, [-0.25]);
/// // The momentum, for a checkpoint.
/// assert_eq!(optimiser.state().len(), 2);
/// # Ok::<(), cape_train::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Optimiser {
    kind: OptimiserKind,
    momentum: f64,
    clip: f64,
    steps: u64,
    moments: BTreeMap<String, Moments>,
}

#[derive(Debug, Clone)]
struct Moments {
    shape: Vec<usize>,
    first: Tensor<1>,
    second: Option<Tensor<1>>,
}

impl Optimiser {
    /// Creates an optimiser without state. Gradients are scaled down to a global norm of at most
    /// `clip`.
    pub fn new(kind: OptimiserKind, momentum: f64, clip: f64) -> Self {
        Self { kind, momentum, clip, steps: 0, moments: BTreeMap::new() }
    }

    /// Updates every parameter of `module` that has a gradient, with learning rate `rate`; `norm`
    /// is the [`global_norm`] of the gradients.
    pub fn step<M: Module>(&mut self, module: M, gradients: &Gradients, norm: f64, rate: f64) -> M {
        let scale = if norm > self.clip { self.clip / norm } else { 1.0 };
        self.steps += 1;
        map_parameters(module, |parameter| {
            let gradient = parameter.gradient(gradients)?;
            let before = self.moments.remove(parameter.path);
            let moments = before.unwrap_or_else(|| Moments {
                shape: parameter.shape.to_vec(),
                first: gradient.zeros_like(),
                second: None,
            });
            let (moments, value) =
                self.advance(moments, parameter.value(), gradient, [scale, rate]);
            self.moments.insert(parameter.path.to_owned(), moments);
            Some(value)
        })
    }

    /// New moments and value of a parameter.
    fn advance(
        &self,
        Moments { shape, first, second }: Moments,
        value: Tensor<1>,
        gradient: Tensor<1>,
        [scale, rate]: [f64; 2],
    ) -> (Moments, Tensor<1>) {
        if self.kind == OptimiserKind::Sgd {
            let step = MomentumStep { scale, momentum: self.momentum, rate };
            let (value, first) = momentum_step(value, gradient, first, step);
            return (Moments { shape, first, second: None }, value);
        }
        let decays = [self.momentum, SECOND_DECAY];
        let corrections = decays.map(|decay| 1.0 - decay.powf(self.steps as f64));
        let step = AdamStep { scale, decays, corrections, epsilon: EPSILON, rate };
        let second = second.unwrap_or_else(|| gradient.zeros_like());
        let [value, first, second] = adam_step(gradient, [value, first, second], step);
        (Moments { shape, first, second: Some(second) }, value)
    }

    /// Moments by the path of the parameter, for a checkpoint.
    pub fn state(&self) -> Weights {
        let array = |shape: &[usize], flat: &Tensor<1>| HostArray {
            shape: shape.to_vec(),
            values: to_host(flat.clone()),
        };
        let mut state = Weights::new();
        for (name, Moments { shape, first, second }) in &self.moments {
            state.insert(name.clone(), array(shape, first));
            if let Some(second) = second {
                state.insert(format!("{name}{SECOND}"), array(shape, second));
            }
        }
        if self.kind == OptimiserKind::Adam {
            let steps = HostArray { shape: vec![1], values: vec![self.steps as f32] };
            state.insert(STEPS.to_owned(), steps);
        }
        state
    }

    /// Restores the moments of a checkpoint, for the parameters of `module`. From the moments of
    /// the other kind of optimiser, Adam takes nothing and momentum the first moments.
    ///
    /// # Errors
    /// If a moment is not of a parameter of `module`, or has another shape.
    pub fn restore<M: Module>(&mut self, module: &M, state: &Weights) -> Result<()> {
        let mut shapes = BTreeMap::new();
        let mut device = None;
        for_each_parameter(module, |parameter| {
            shapes.insert(parameter.path.to_owned(), parameter.shape.to_vec());
            device = Some(parameter.device());
        });
        let Some(device) = device else { return Ok(()) };
        let device = device.inner();
        let tensor = |array: &HostArray| {
            let data = TensorData::new(array.values.clone(), [array.values.len()]);
            Tensor::<1>::from_data(data, &device)
        };
        let of_parameters = || state.iter().filter(|(name, _)| *name != STEPS);
        for (name, array) in of_parameters() {
            let name = name.strip_suffix(SECOND).unwrap_or(name);
            if shapes.get(name) != Some(&array.shape) {
                return Err(Error::Model(cape_model::Error::Weight {
                    name: name.to_owned(),
                    message: match shapes.get(name) {
                        Some(shape) => {
                            format!(
                                "optimiser state of shape {:?}, expected {shape:?}",
                                array.shape
                            )
                        }
                        None => {
                            "optimiser state of a parameter that the model does not have".into()
                        }
                    },
                }));
            }
        }
        self.moments.clear();
        self.steps = 0;
        if self.kind == OptimiserKind::Adam {
            let steps = state.get(STEPS).and_then(|steps| steps.values.first());
            let Some(&steps) = steps else { return Ok(()) };
            self.steps = steps as u64;
        }
        for (name, array) in of_parameters().filter(|(name, _)| !name.ends_with(SECOND)) {
            let second = state.get(&format!("{name}{SECOND}"));
            let moments = Moments {
                shape: array.shape.clone(),
                first: tensor(array),
                second: second.filter(|_| self.kind == OptimiserKind::Adam).map(tensor),
            };
            self.moments.insert(name.clone(), moments);
        }
        Ok(())
    }
}

/// Euclidean norm of all gradients of `module` together.
pub fn global_norm<M: Module>(module: &M, gradients: &Gradients) -> f64 {
    let mut vectors = Vec::new();
    for_each_parameter(module, |parameter| vectors.extend(parameter.gradient(gradients)));
    let Some(device) = vectors.first().map(Tensor::device) else { return 0.0 };
    to_host(sums_of_squares(vectors, &device)).into_iter().map(f64::from).sum::<f64>().sqrt()
}

/// Copies the gradients of all parameters of `module` to the host, by the path of the parameter.
pub fn collect_gradients<M: Module>(module: &M, gradients: &Gradients) -> Weights {
    let mut found = Weights::new();
    for_each_parameter(module, |parameter| {
        if let Some(gradient) = parameter.gradient(gradients) {
            let array = HostArray { shape: parameter.shape.to_vec(), values: to_host(gradient) };
            found.insert(parameter.path.to_owned(), array);
        }
    });
    found
}

#[cfg(test)]
mod tests {
    use burn::module::{Param, ParamId};

    use super::*;

    #[derive(Module, Debug)]
    struct Point {
        at: Param<Tensor<1>>,
    }

    /// Minimises `½ Σ kᵢ xᵢ²` for `steps` steps.
    fn descend(optimiser: &mut Optimiser, mut point: Point, steps: usize) -> Point {
        let device = point.at.val().device();
        let stiffness = Tensor::<1>::from_data([1.0f32, 10.0], &device);
        for _ in 0..steps {
            let x = point.at.val();
            let gradients = (x.clone() * x * stiffness.clone() * 0.5).sum().backward();
            let norm = global_norm(&point, &gradients);
            point = optimiser.step(point, &gradients, norm, 0.05);
        }
        point
    }

    fn start() -> Point {
        let device = cape_core::parse_device(cape_core::DEVICES[0]).unwrap().autodiff();
        let at = Tensor::<1>::from_data([3.0f32, -2.0], &device).require_grad();
        Point { at: Param::initialized(ParamId::new(), at) }
    }

    fn values(point: &Point) -> Vec<f32> {
        point.at.val().detach().into_data().try_into_vec().unwrap()
    }

    /// Both update rules written out for each coordinate in f64.
    fn by_hand(kind: OptimiserKind, steps: i32) -> [f64; 2] {
        let (mut x, mut m, mut v) = ([3.0f64, -2.0], [0.0; 2], [0.0; 2]);
        for step in 1..=steps {
            for (i, stiffness) in [1.0, 10.0].into_iter().enumerate() {
                let g = stiffness * x[i];
                x[i] -= match kind {
                    OptimiserKind::Sgd => {
                        m[i] = 0.9 * m[i] + g;
                        0.05 * m[i]
                    }
                    OptimiserKind::Adam => {
                        m[i] = 0.9 * m[i] + 0.1 * g;
                        v[i] = 0.999 * v[i] + 0.001 * g * g;
                        let unbiased = (v[i] / (1.0 - 0.999f64.powi(step))).sqrt();
                        0.05 * m[i] / (1.0 - 0.9f64.powi(step)) / (unbiased + 1e-8)
                    }
                };
            }
        }
        x
    }

    #[test]
    fn both_rules_follow_their_definitions_also_after_a_restart() {
        for kind in [OptimiserKind::Sgd, OptimiserKind::Adam] {
            let mut optimiser = Optimiser::new(kind, 0.9, 1e9);
            let halfway = descend(&mut optimiser, start(), 5);
            let mut resumed = Optimiser::new(kind, 0.9, 1e9);
            resumed.restore(&halfway, &optimiser.state()).unwrap();
            let whole = descend(&mut optimiser, halfway.clone(), 5);
            assert_eq!(values(&whole), values(&descend(&mut resumed, halfway, 5)));
            for (found, expected) in values(&whole).into_iter().zip(by_hand(kind, 10)) {
                assert!((f64::from(found) - expected).abs() < 1e-5, "{kind:?}: {found} {expected}");
            }
        }
    }

    #[test]
    fn moments_of_the_other_rule_do_no_harm() {
        let mut sgd = Optimiser::new(OptimiserKind::Sgd, 0.9, 1e9);
        let point = descend(&mut sgd, start(), 5);
        let mut adam = Optimiser::new(OptimiserKind::Adam, 0.9, 1e9);
        adam.restore(&point, &sgd.state()).unwrap();
        let mut fresh = Optimiser::new(OptimiserKind::Adam, 0.9, 1e9);
        let expected = values(&descend(&mut fresh, point.clone(), 3));
        assert_eq!(values(&descend(&mut adam, point.clone(), 3)), expected);
        let mut back = Optimiser::new(OptimiserKind::Sgd, 0.9, 1e9);
        back.restore(&point, &adam.state()).unwrap();
        assert!(values(&descend(&mut back, point, 3)).iter().all(|x| x.is_finite()));
    }
}
