//! One update of generator and discriminator, encoding and decoding, on 6890 vertices.

#![allow(missing_docs)] // criterion's macro makes a public function

use std::time::Duration;

use burn::tensor::{Device, Distribution, Tensor};
use cape::{
    core::Mesh,
    graph::{DevicePyramid, MeshPyramid, SparseMatrix, Surface, Weighting},
    model::{Cape, CapeConfig, Graphs, LossConfig},
    train::{
        objective::{Frames, StepInput, evaluate},
        optim::{Momentum, global_norm},
    },
};
use criterion::{Criterion, criterion_group, criterion_main};
use sprs::TriMat;

/// A torus of 65 × 106 = 6890 vertices.
fn torus() -> Mesh {
    let (rings, sides) = (106u32, 65u32);
    let angle = |i: u32, n: u32| i as f32 / n as f32 * std::f32::consts::TAU;
    let mut mesh = Mesh::default();
    for ring in 0..rings {
        for side in 0..sides {
            let (u, v) = (angle(ring, rings), angle(side, sides));
            let radius = 0.5 + 0.2 * v.cos() + 0.01 * (3.0 * u + v).sin();
            mesh.vertices.push([radius * u.cos(), 0.2 * v.sin(), radius * u.sin()]);
            let at = |r: u32, s: u32| (r % rings) * sides + s % sides;
            let (a, b) = (at(ring, side), at(ring, side + 1));
            let (c, d) = (at(ring + 1, side), at(ring + 1, side + 1));
            mesh.faces.extend([[a, b, c], [b, d, c]]);
        }
    }
    mesh
}

fn graphs(config: &CapeConfig, device: &Device) -> Graphs {
    let surface = Surface::from(&torus());
    let pyramid = |factors: &[u32]| {
        let factors: Vec<f64> = factors.iter().map(|&f| f64::from(f)).collect();
        let built = MeshPyramid::build(surface.clone(), &factors, Weighting::default()).unwrap();
        DevicePyramid::upload(&built, device)
    };
    let edges = surface.edges();
    let mut difference = TriMat::new((edges.len(), surface.vertices.len()));
    for (row, [a, b]) in edges.into_iter().enumerate() {
        difference.add_triplet(row, a as usize, 1.0);
        difference.add_triplet(row, b as usize, -1.0);
    }
    Graphs {
        generator: pyramid(&config.factors),
        discriminator: config.discriminator.as_ref().map(|d| pyramid(&d.factors)),
        edges: SparseMatrix::new(&difference.to_csr(), device),
    }
}

fn frames(batch: usize, device: &Device) -> Frames {
    let normal = Distribution::Normal(0.0, 1.0);
    Frames {
        displacement: Tensor::random([batch, 6890, 3], normal, device),
        pose_feature: Tensor::random([batch, 126], normal, device),
        outfit: Tensor::ones([batch, 4], device) * 0.25,
    }
}

fn update(criterion: &mut Criterion, name: &str, config: &CapeConfig) {
    let device = Device::flex().autodiff();
    let graphs = graphs(config, &device);
    let mut model = Cape::new(config, &graphs, 1, &device).unwrap();
    let mut optimisers = [Momentum::new(0.9, 5.0), Momentum::new(0.9, 5.0)];
    let input = StepInput {
        frames: frames(16, &device),
        epsilon: Some(Tensor::zeros([16, config.latent], &device)),
        real: Some(frames(16, &device)),
    };
    let loss = LossConfig::default();
    let mut group = criterion.benchmark_group("update");
    group.sample_size(10).warm_up_time(Duration::from_secs(3));
    group.bench_function(name, |bencher| {
        bencher.iter(|| {
            let evaluation = evaluate(&model, &graphs, &loss, &input);
            let Cape { generator, discriminator } = model.clone();
            let norm = global_norm(&generator, &evaluation.generator);
            let generator = optimisers[0].step(generator, &evaluation.generator, norm, 1e-4);
            let (d, gradients) = (discriminator.unwrap(), evaluation.discriminator.unwrap());
            let norm = global_norm(&d, &gradients);
            let d = optimisers[1].step(d, &gradients, norm, 1e-5);
            model = Cape { generator, discriminator: Some(d) };
        });
    });
    group.finish();
}

fn inference(criterion: &mut Criterion) {
    let config = CapeConfig::paper();
    let device = Device::flex();
    let graphs = graphs(&config, &device);
    let model = Cape::new(&config, &graphs, 1, &device).unwrap().generator;
    let mut group = criterion.benchmark_group("inference");
    group.sample_size(10);
    for batch in [1, 16] {
        let input = frames(batch, &device);
        let z = Tensor::zeros([batch, config.latent], &device);
        group.bench_function(format!("decode batch {batch}"), |bencher| {
            bencher.iter(|| {
                let Frames { pose_feature, outfit, .. } = input.clone();
                model.decode(z.clone(), pose_feature, outfit, &graphs)
            });
        });
    }
    let input = frames(16, &device);
    group.bench_function("encode batch 16", |bencher| {
        bencher.iter(|| model.encoder.forward(input.displacement.clone(), None, &graphs.generator));
    });
    group.finish();
}

fn benches(criterion: &mut Criterion) {
    update(criterion, "narrow, batch 16", &CapeConfig::narrow());
    update(criterion, "paper, batch 16", &CapeConfig::paper());
    inference(criterion);
}

criterion_group!(all, benches);
criterion_main!(all);
