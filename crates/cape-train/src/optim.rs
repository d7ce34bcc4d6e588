//! Gradient descent with momentum and clipping by the global norm (facts of the paper's training:
//! `v ← μ v + g`, `w ← w − lr · v`).

use std::collections::BTreeMap;

use burn::{
    module::{Module, ModuleMapper, ModuleVisitor, Param},
    tensor::{Gradients, Tensor, TensorData},
};
use cape_model::weights::{Array, Trail, Weights};

use crate::{Error, Result};

/// Momentum's state: one velocity a parameter.
#[derive(Debug, Clone)]
pub struct Momentum {
    coefficient: f64,
    clip: f64,
    velocity: BTreeMap<String, Velocity>,
}

#[derive(Debug, Clone)]
struct Velocity {
    shape: Vec<usize>,
    flat: Tensor<1>,
}

impl Momentum {
    /// At rest; gradients longer than `clip` as a whole are shortened to it.
    pub fn new(momentum: f64, clip: f64) -> Self {
        Self { coefficient: momentum, clip, velocity: BTreeMap::new() }
    }

    /// Moves every parameter of `module` that has a gradient; `norm` is the [`global_norm`] of the
    /// gradients.
    pub fn step<M: Module>(&mut self, module: M, gradients: &Gradients, norm: f64, rate: f64) -> M {
        let scale = if norm > self.clip { self.clip / norm } else { 1.0 };
        module.map(&mut Stepper {
            trail: Trail::default(),
            optimiser: self,
            gradients,
            rate,
            scale,
        })
    }

    /// The velocities, for a checkpoint.
    pub fn state(&self) -> Weights {
        self.velocity
            .iter()
            .map(|(name, velocity)| {
                let values = velocity
                    .flat
                    .clone()
                    .into_data()
                    .try_into_vec()
                    .unwrap_or_else(|_| unreachable!("velocities are f32"));
                (name.clone(), Array { shape: velocity.shape.clone(), values })
            })
            .collect()
    }

    /// Puts the velocities of a checkpoint back, for the parameters of `module`.
    ///
    /// # Errors
    /// If a velocity is not of a parameter of `module`, or of another shape.
    pub fn restore<M: Module>(&mut self, module: &M, state: &Weights) -> Result<()> {
        let mut shapes = BTreeMap::new();
        let mut device = None;
        cape_model::weights::for_each_parameter(module, |path, parameter| {
            shapes.insert(path.to_owned(), parameter.shape.to_vec());
            device = Some(parameter.device());
        });
        let Some(device) = device else { return Ok(()) };
        self.velocity.clear();
        for (name, array) in state {
            if shapes.get(name) != Some(&array.shape) {
                return Err(Error::Model(cape_model::Error::Weight {
                    name: name.clone(),
                    message: format!(
                        "optimiser state of shape {:?}, the model has {:?}",
                        array.shape,
                        shapes.get(name)
                    ),
                }));
            }
            let data = TensorData::new(array.values.clone(), [array.values.len()]);
            let flat = Tensor::from_data(data, &device.clone().inner());
            self.velocity.insert(name.clone(), Velocity { shape: array.shape.clone(), flat });
        }
        Ok(())
    }
}

/// Euclidean norm of all gradients of `module` together.
pub fn global_norm<M: Module>(module: &M, gradients: &Gradients) -> f64 {
    struct Squares<'a> {
        gradients: &'a Gradients,
        sums: Vec<Tensor<1>>,
    }
    impl ModuleVisitor for Squares<'_> {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            if let Some(gradient) = param.val().grad(self.gradients) {
                self.sums.push((gradient.clone() * gradient).sum());
            }
        }
    }
    let mut squares = Squares { gradients, sums: Vec::new() };
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
        trail: Trail,
        gradients: &'a Gradients,
        found: Weights,
    }
    impl ModuleVisitor for Collector<'_> {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            if let Some(gradient) = param.val().grad(self.gradients) {
                let shape = gradient.dims().to_vec();
                let values = gradient
                    .into_data()
                    .try_into_vec()
                    .unwrap_or_else(|_| unreachable!("gradients are f32"));
                self.found.insert(self.trail.path(), Array { shape, values });
            }
        }
        fn enter_module(&mut self, name: &str, container: &str) {
            self.trail.enter(name, container);
        }
        fn exit_module(&mut self, _: &str, _: &str) {
            self.trail.exit();
        }
    }
    let mut collector = Collector { trail: Trail::default(), gradients, found: Weights::new() };
    module.visit(&mut collector);
    collector.found
}

struct Stepper<'a> {
    trail: Trail,
    optimiser: &'a mut Momentum,
    gradients: &'a Gradients,
    rate: f64,
    scale: f64,
}

impl ModuleMapper for Stepper<'_> {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let Some(gradient) = param.val().grad(self.gradients) else { return param };
        let shape = gradient.dims();
        let gradient = gradient.reshape([-1]) * self.scale;
        let path = self.trail.path();
        let flat = match self.optimiser.velocity.remove(&path) {
            Some(velocity) => velocity.flat * self.optimiser.coefficient + gradient,
            None => gradient,
        };
        let velocity = Velocity { shape: shape.to_vec(), flat: flat.clone() };
        self.optimiser.velocity.insert(path, velocity);
        param.map(|old| {
            let moved = old.inner() - flat.reshape(shape) * self.rate;
            Tensor::from_inner(moved).require_grad()
        })
    }

    fn enter_module(&mut self, name: &str, container: &str) {
        self.trail.enter(name, container);
    }

    fn exit_module(&mut self, _: &str, _: &str) {
        self.trail.exit();
    }
}
