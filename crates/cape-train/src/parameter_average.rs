//! Running averages of weights.

use std::collections::BTreeMap;

use burn::{
    module::{Module, ModuleMapper, ModuleVisitor, Param},
    tensor::Tensor,
};
use cape_model::weights::{self, HostArray, ParamPath, Weights};

use crate::Result;
use cape_core::tensors::to_host;

/// An exponential average of every parameter of a module, over steps.
///
/// Early on the factor is lower, `(1 + t) / (10 + t)`, so that initial weights are forgotten.
#[derive(Debug, Clone)]
pub(crate) struct ParameterAverage {
    factor: f64,
    values: BTreeMap<String, (Vec<usize>, Tensor<1>)>,
}

impl ParameterAverage {
    /// Nothing yet.
    pub(crate) fn new(factor: f64) -> Self {
        Self { factor, values: BTreeMap::new() }
    }

    /// Takes in the weights after step `step`, counted from 1.
    pub(crate) fn update<M: Module>(&mut self, module: &M, step: u64) {
        let step = step as f64;
        let factor = self.factor.min((1.0 + step) / (10.0 + step));
        module.visit(&mut UpdateVisitor { path: ParamPath::default(), average: self, factor });
    }

    /// The module with averaged weights.
    pub(crate) fn apply<M: Module>(&self, module: M) -> M {
        module.map(&mut ApplyMapper { path: ParamPath::default(), average: self })
    }

    /// The averages, for a checkpoint.
    pub(crate) fn state(&self) -> Weights {
        let arrays = self.values.iter().map(|(name, (shape, flat))| {
            let values = to_host(flat.clone());
            (name.clone(), HostArray { shape: shape.clone(), values })
        });
        arrays.collect()
    }

    /// Puts the averages of a checkpoint back, for the parameters of `module`.
    ///
    /// # Errors
    /// If they are not those of `module`.
    pub(crate) fn restore<M: Module>(&mut self, module: &M, state: &Weights) -> Result<()> {
        let module = weights::apply(module.clone(), state)?;
        self.values.clear();
        self.update(&module, 0);
        Ok(())
    }
}

struct UpdateVisitor<'a> {
    path: ParamPath,
    average: &'a mut ParameterAverage,
    factor: f64,
}

impl ModuleVisitor for UpdateVisitor<'_> {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let new = param.val().inner();
        let shape = new.dims().to_vec();
        let new = new.reshape([-1]);
        let path = self.path.path();
        let value = match self.average.values.remove(&path) {
            Some((_, old)) => old * self.factor + new * (1.0 - self.factor),
            None => new,
        };
        self.average.values.insert(path, (shape, value));
    }
    fn enter_module(&mut self, name: &str, container: &str) {
        self.path.enter(name, container);
    }
    fn exit_module(&mut self, _: &str, _: &str) {
        self.path.exit();
    }
}

struct ApplyMapper<'a> {
    path: ParamPath,
    average: &'a ParameterAverage,
}

impl ModuleMapper for ApplyMapper<'_> {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let Some((_, value)) = self.average.values.get(&self.path.path()) else { return param };
        let value = value.clone();
        param.map(|old| Tensor::from_inner(value.reshape(old.dims())))
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
