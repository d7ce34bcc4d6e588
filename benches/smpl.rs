//! Posing batches of bodies of SMPL's size, without gradients.

#![allow(missing_docs)] // criterion's macro makes a public function

use std::time::Duration;

use burn::tensor::{Device, Distribution, Tensor};
use cape::core::{Pose, Smpl, SmplInput, SmplModel, joints::PARENTS};
use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use ndarray::{Array, Array2, Axis, Dimension, ShapeBuilder};

const VERTICES: usize = 6890;
const JOINTS: usize = 24;

/// Numbers in `[0, 1)` (Knuth's MMIX generator).
struct Uniform(u64);

impl Uniform {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Numbers in `[-scale, scale)`.
    fn array<D: Dimension, S: ShapeBuilder<Dim = D>>(
        &mut self,
        shape: S,
        scale: f64,
    ) -> Array<f64, D> {
        Array::from_shape_simple_fn(shape, || scale * (2.0 * self.next() - 1.0))
    }
}

fn normalised(mut rows: Array2<f64>) -> Array2<f64> {
    for mut row in rows.axis_iter_mut(Axis(0)) {
        let sum = row.sum();
        row /= sum;
    }
    rows
}

/// A random body with `bones` non-zero blend weights a vertex.
fn body(bones: usize) -> SmplModel {
    let random = &mut Uniform(1);
    let mut weights = Array2::zeros((VERTICES, JOINTS));
    for mut row in weights.axis_iter_mut(Axis(0)) {
        let first = (random.next() * JOINTS as f64) as usize;
        for bone in 0..bones {
            row[(first + bone) % JOINTS] = 0.01 + random.next();
        }
    }
    SmplModel {
        v_template: random.array((VERTICES, 3), 1.0),
        shapedirs: random.array((VERTICES, 3, 10), 0.05),
        posedirs: random.array((VERTICES, 3, 9 * (JOINTS - 1)), 0.01),
        joint_regressor: normalised(random.array((JOINTS, VERTICES), 1.0).abs()),
        weights: normalised(weights),
        parents: PARENTS.to_vec(),
        faces: Vec::new(),
    }
}

fn input(batch: usize, clothed: bool, device: &Device) -> SmplInput {
    let normal = |deviation| Distribution::Normal(0.0, deviation);
    SmplInput {
        betas: Tensor::random([batch, 10], normal(1.0), device),
        pose: Pose::AxisAngle(Tensor::random([batch, 3 * JOINTS], normal(0.3), device)),
        transl: Tensor::zeros([batch, 3], device),
        displacement: clothed.then(|| Tensor::random([batch, VERTICES, 3], normal(0.01), device)),
    }
}

fn forward(criterion: &mut Criterion) {
    let device = Device::flex();
    let mut group = criterion.benchmark_group("smpl");
    group.sample_size(20).warm_up_time(Duration::from_secs(1));
    group.measurement_time(Duration::from_secs(2));
    for (name, bones, clothed) in
        [("4 weights", 4, false), ("24 weights", 24, false), ("4 weights, clothed", 4, true)]
    {
        let smpl = Smpl::new(&body(bones), &device).unwrap();
        for batch in [1, 16, 256] {
            let input = input(batch, clothed, &device);
            // Displacements that nobody else holds, as from a decoder.
            let fresh = || SmplInput {
                displacement: input.displacement.clone().map(|clothes| clothes * 1.0),
                ..input.clone()
            };
            group.bench_function(format!("{name}, batch {batch}"), |bencher| {
                let pose = |input| drop(smpl.forward(input).unwrap());
                bencher.iter_batched(fresh, pose, BatchSize::PerIteration);
            });
        }
    }
    group.finish();
}

criterion_group!(all, forward);
criterion_main!(all);
