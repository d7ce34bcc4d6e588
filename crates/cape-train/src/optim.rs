//! Gradient descent with momentum, or Adam, and clipping by the global norm.

use std::collections::BTreeMap;

use burn::{
    module::{Module, ModuleMapper, ModuleVisitor, Param},
    tensor::{Gradients, Tensor, TensorData},
};
use cape_model::weights::{HostArray, ParamPath, Weights};

use crate::{Error, Result};
use cape_core::tensors::to_host;
use cape_infer::OptimiserKind;

/// Added to the names of second moments in [`Optimiser::state`].
const SECOND: &str = ".second_moment";
/// Name of Adam's number of steps in [`Optimiser::state`].
const STEPS: &str = "steps";
/// Adam's β₂ and ε.
const SECOND_DECAY: f64 = 0.999;
const EPSILON: f64 = 1e-8;

/// A rule and its state: one or two moments a parameter.
///
/// ```
/// use burn::tensor::{Device, Tensor};
/// use cape_model::{Initialiser, layers::Linear, weights::collect};
/// use cape_infer::OptimiserKind;
/// use cape_train::optim::{Optimiser, global_norm};
///
/// let device = Device::default().autodiff();
/// let layer = Linear::new(1, 1, &mut Initialiser::new(1, 0.1, &device));
/// // w x + b at x = 1 has the gradient (1, 1).
/// let gradients = layer.forward(Tensor::ones([1, 1], &device)).sum().backward();
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
    /// At rest; gradients longer than `clip` as a whole are shortened to it.
    pub fn new(kind: OptimiserKind, momentum: f64, clip: f64) -> Self {
        Self { kind, momentum, clip, steps: 0, moments: BTreeMap::new() }
    }

    /// Moves every parameter of `module` that has a gradient; `norm` is the [`global_norm`] of the
    /// gradients.
    pub fn step<M: Module>(&mut self, module: M, gradients: &Gradients, norm: f64, rate: f64) -> M {
        let scale = if norm > self.clip { self.clip / norm } else { 1.0 };
        self.steps += 1;
        module.map(&mut Stepper {
            path: ParamPath::default(),
            optimiser: self,
            gradients,
            rate,
            scale,
        })
    }

    /// The new moments of a parameter, and the direction it moves against.
    fn advance(
        &self,
        before: Option<Moments>,
        gradient: Tensor<1>,
        shape: Vec<usize>,
    ) -> (Moments, Tensor<1>) {
        let (first, second) = before.map_or((None, None), |m| (Some(m.first), m.second));
        if self.kind == OptimiserKind::Sgd {
            let first = match first {
                Some(first) => first * self.momentum + gradient,
                None => gradient,
            };
            return (Moments { shape, first: first.clone(), second: None }, first);
        }
        let decayed = |moment: Option<Tensor<1>>, decay: f64, new: Tensor<1>| match moment {
            Some(moment) => moment * decay + new * (1.0 - decay),
            None => new * (1.0 - decay),
        };
        let first = decayed(first, self.momentum, gradient.clone());
        let second = decayed(second, SECOND_DECAY, gradient.clone() * gradient);
        let unbiased = |decay: f64| 1.0 - decay.powf(self.steps as f64);
        let deviation = (second.clone() / unbiased(SECOND_DECAY)).sqrt() + EPSILON;
        let direction = first.clone() / unbiased(self.momentum) / deviation;
        (Moments { shape, first, second: Some(second) }, direction)
    }

    /// The moments, for a checkpoint.
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

    /// Puts the moments of a checkpoint back, for the parameters of `module`. Those of another rule
    /// are of no use: Adam then starts afresh, and momentum takes the first moments only.
    ///
    /// # Errors
    /// If a moment is not of a parameter of `module`, or of another shape.
    pub fn restore<M: Module>(&mut self, module: &M, state: &Weights) -> Result<()> {
        let mut shapes = BTreeMap::new();
        let mut device = None;
        cape_model::weights::for_each_parameter(module, |path, parameter| {
            shapes.insert(path.to_owned(), parameter.shape.to_vec());
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
                    message: format!(
                        "optimiser state of shape {:?}, the model has {:?}",
                        array.shape,
                        shapes.get(name)
                    ),
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
    struct SquaredNorms<'a> {
        gradients: &'a Gradients,
        sums: Vec<Tensor<1>>,
    }
    impl ModuleVisitor for SquaredNorms<'_> {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            if let Some(gradient) = param.val().grad(self.gradients) {
                self.sums.push((gradient.clone() * gradient).sum());
            }
        }
    }
    let mut squares = SquaredNorms { gradients, sums: Vec::new() };
    module.visit(&mut squares);
    if squares.sums.is_empty() {
        return 0.0;
    }
    let sums: Vec<f32> = Tensor::cat(squares.sums, 0)
        .into_data()
        .try_into_vec()
        .unwrap_or_else(|_| unreachable!("gradients are f32"));
    sums.into_iter().map(f64::from).sum::<f64>().sqrt()
}

/// Copies every parameter's gradient to the host, by the parameter's path.
pub fn collect_gradients<M: Module>(module: &M, gradients: &Gradients) -> Weights {
    struct Collector<'a> {
        path: ParamPath,
        gradients: &'a Gradients,
        found: Weights,
    }
    impl ModuleVisitor for Collector<'_> {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            if let Some(gradient) = param.val().grad(self.gradients) {
                let shape = gradient.dims().to_vec();
                let values = to_host(gradient);
                self.found.insert(self.path.path(), HostArray { shape, values });
            }
        }
        fn enter_module(&mut self, name: &str, container: &str) {
            self.path.enter(name, container);
        }
        fn exit_module(&mut self, _: &str, _: &str) {
            self.path.exit();
        }
    }
    let mut collector = Collector { path: ParamPath::default(), gradients, found: Weights::new() };
    module.visit(&mut collector);
    collector.found
}

struct Stepper<'a> {
    path: ParamPath,
    optimiser: &'a mut Optimiser,
    gradients: &'a Gradients,
    rate: f64,
    scale: f64,
}

impl ModuleMapper for Stepper<'_> {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let Some(gradient) = param.val().grad(self.gradients) else { return param };
        let shape = gradient.dims();
        let gradient = gradient.reshape([-1]) * self.scale;
        let path = self.path.path();
        let before = self.optimiser.moments.remove(&path);
        let (moments, direction) = self.optimiser.advance(before, gradient, shape.to_vec());
        self.optimiser.moments.insert(path, moments);
        param.map(|old| {
            let moved = old.inner() - direction.reshape(shape) * self.rate;
            Tensor::from_inner(moved).require_grad()
        })
    }

    fn enter_module(&mut self, name: &str, container: &str) {
        self.path.enter(name, container);
    }

    fn exit_module(&mut self, _: &str, _: &str) {
        self.path.exit();
    }
}

#[cfg(test)]
mod tests {
    use burn::module::ParamId;

    use super::*;

    #[derive(Module, Debug)]
    struct Point {
        at: Param<Tensor<1>>,
    }

    /// Steps on `½ Σ kᵢ xᵢ²` from `start`.
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

    /// Both rules written out for each coordinate in f64.
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
