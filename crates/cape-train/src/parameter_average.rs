//! Exponential moving average of weights.

use std::collections::BTreeMap;

use burn::{module::Module, tensor::Tensor};
use cape_model::weights::{self, HostArray, Weights, for_each_parameter, map_parameters};

use crate::Result;
use cape_core::tensors::to_host;

/// Exponential moving average over training steps of every parameter of a module.
///
/// In step `t` the factor is at most `(1 + t) / (10 + t)`, so that the initial weights do not
/// dominate.
#[derive(Debug, Clone)]
pub(crate) struct ParameterAverage {
    factor: f64,
    values: BTreeMap<String, (Vec<usize>, Tensor<1>)>,
}

impl ParameterAverage {
    /// Creates an average without values.
    pub(crate) fn new(factor: f64) -> Self {
        Self { factor, values: BTreeMap::new() }
    }

    /// Adds the weights of `module` after step `step`, counted from 1.
    pub(crate) fn update<M: Module>(&mut self, module: &M, step: u64) {
        let step = step as f64;
        let factor = self.factor.min((1.0 + step) / (10.0 + step));
        for_each_parameter(module, |parameter| {
            let new = parameter.value();
            let value = match self.values.remove(parameter.path) {
                Some((_, old)) => old * factor + new * (1.0 - factor),
                None => new,
            };
            self.values.insert(parameter.path.to_owned(), (parameter.shape.to_vec(), value));
        });
    }

    /// Replaces the weights of `module` by their averages.
    pub(crate) fn apply<M: Module>(&self, module: M) -> M {
        map_parameters(module, |parameter| {
            self.values.get(parameter.path).map(|(_, value)| value.clone())
        })
    }

    /// Averages by the path of the parameter, for a checkpoint.
    pub(crate) fn state(&self) -> Weights {
        let arrays = self.values.iter().map(|(name, (shape, flat))| {
            let values = to_host(flat.clone());
            (name.clone(), HostArray { shape: shape.clone(), values })
        });
        arrays.collect()
    }

    /// Restores the averages of a checkpoint, for the parameters of `module`.
    ///
    /// # Errors
    /// If `state` does not have the parameters of `module`.
    pub(crate) fn restore<M: Module>(&mut self, module: &M, state: &Weights) -> Result<()> {
        let module = weights::apply(module.clone(), state)?;
        self.values.clear();
        self.update(&module, 0);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use burn::module::{Param, ParamId};

    use super::*;

    #[derive(Module, Debug)]
    struct Point {
        at: Param<Tensor<2>>,
    }

    fn point(values: [[f32; 2]; 1]) -> Point {
        let device = cape_core::parse_device(cape_core::DEVICES[0]).unwrap().autodiff();
        let at = Tensor::<2>::from_data(values, &device).require_grad();
        Point { at: Param::initialized(ParamId::new(), at) }
    }

    #[test]
    fn averages_follow_their_definition_and_survive_a_restart() {
        let mut average = ParameterAverage::new(0.5);
        let mut expected = [0.0f64; 2];
        for step in 1..=20u32 {
            let new = [f64::from(step), f64::from(step).sin()];
            let factor = 0.5f64.min(f64::from(1 + step) / f64::from(10 + step));
            for (old, new) in expected.iter_mut().zip(new) {
                *old = if step == 1 { new } else { factor * *old + (1.0 - factor) * new };
            }
            average.update(&point([new.map(|x| x as f32)]), u64::from(step));
        }
        let mut restored = ParameterAverage::new(0.5);
        let fresh = point([[0.0, 0.0]]);
        restored.restore(&fresh, &average.state()).unwrap();
        for average in [average, restored] {
            let applied = average.apply(fresh.clone()).at.val().into_data();
            let found: Vec<f32> = applied.try_into_vec().unwrap();
            for (found, expected) in found.into_iter().zip(expected) {
                assert!((f64::from(found) - expected).abs() < 1e-5);
            }
        }
    }
}
