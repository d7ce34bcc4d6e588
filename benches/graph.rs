//! The graph operations level by level, and building the pyramid, on 6890 vertices.

#![allow(missing_docs)] // criterion's macro makes a public function

mod mesh;

use burn::tensor::{Device, Distribution, Tensor};
use cape::graph::{
    ConvGraph, DevicePyramid, Epilogue, GroupNorm, MeshPyramid, Surface, Weighting, cheb_conv,
    norm_conv, sparse_matmul,
};
use criterion::{Criterion, criterion_group, criterion_main};

const BATCH: usize = 16;
/// Level, channels in and out of the encoder's convolutions, the discriminator's order aside.
const LEVELS: [(usize, usize, usize); 8] = [
    (0, 3, 64),
    (1, 64, 64),
    (2, 64, 128),
    (3, 128, 128),
    (4, 128, 256),
    (5, 256, 256),
    (6, 256, 512),
    (7, 512, 512),
];
const FACTORS: [f64; 8] = [1.0, 2.0, 1.0, 2.0, 1.0, 2.0, 1.0, 1.0];

fn pyramid() -> MeshPyramid {
    let surface = Surface::from(&mesh::torus(106, 65));
    MeshPyramid::build(surface, &FACTORS, Weighting::default()).unwrap()
}

fn random<const D: usize>(shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::random(shape, Distribution::Normal(0.0, 1.0), device)
}

fn levels(criterion: &mut Criterion) {
    let device = Device::flex();
    let tracked = device.clone().autodiff();
    let pyramid = DevicePyramid::upload(&pyramid(), &device);
    let mut group = criterion.benchmark_group("level");
    group.sample_size(10);
    for (level, input, output) in LEVELS {
        let graph = pyramid.pooled(level);
        let name = format!(
            "{level}, {} to {} vertices, {input} to {output}",
            graph.vertices(),
            graph.kept()
        );
        let x = random([BATCH, graph.vertices(), input], &device);
        let weight = random([2 * input, output], &device) * 0.05;
        let laplacian = graph.laplacian();
        group.bench_function(format!("spmm {name}"), |bencher| {
            bencher.iter(|| sparse_matmul(x.clone(), &laplacian));
        });
        let conv = |x: Tensor<3>, weight: Tensor<2>| {
            let constant_terms = Some(Tensor::ones([BATCH, 1, output], &x.device()));
            cheb_conv(x, weight, graph, 2, Epilogue { constant_terms, slope: Some(0.2) })
        };
        group.bench_function(format!("chebyshev forward {name}"), |bencher| {
            bencher.iter(|| conv(x.clone(), weight.clone()));
        });
        let track =
            |x: &Tensor<3>| Tensor::from_inner(x.clone()).to_device(&tracked).require_grad();
        let tracked_weight = Tensor::from_inner(weight.clone()).require_grad();
        group.bench_function(format!("chebyshev forward and backward {name}"), |bencher| {
            bencher.iter(|| {
                conv(track(&x), tracked_weight.clone()).sum().backward();
            });
        });
    }
    group.finish();
}

/// A residual block's three normalised convolutions.
fn residual(criterion: &mut Criterion) {
    let device = Device::flex();
    let pyramid = DevicePyramid::upload(&pyramid(), &device);
    let mut group = criterion.benchmark_group("residual block");
    group.sample_size(10);
    for (level, input, output) in [(7, 512, 512), (3, 128, 128), (0, 64, 64)] {
        let graph: &ConvGraph = pyramid.graph(level);
        let half = output / 2;
        let x = random([BATCH, graph.vertices(), input], &device);
        let norm = |channels: usize| GroupNorm {
            gamma: Tensor::ones([channels], &device),
            beta: Tensor::zeros([channels], &device),
            groups: channels.min(32),
            epsilon: 1e-5,
        };
        let weights = [(input, half), (2 * half, half), (half, output)]
            .map(|(rows, columns)| random([rows, columns], &device) * 0.05);
        group.bench_function(
            format!("{} vertices, {output} channels", graph.vertices()),
            |bencher| {
                bencher.iter(|| {
                    let [first, second, third] = weights.clone();
                    let y = norm_conv(x.clone(), None, norm(input), first, graph, 1, None);
                    let y = norm_conv(y, None, norm(half), second, graph, 2, None);
                    norm_conv(y, None, norm(half), third, graph, 1, Some(x.clone()))
                });
            },
        );
    }
    group.finish();
}

fn build(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("pyramid");
    group.sample_size(10);
    let surface = Surface::from(&mesh::torus(106, 65));
    group.bench_function("generator's factors, all levels and both matrices", |bencher| {
        bencher
            .iter(|| MeshPyramid::build(surface.clone(), &FACTORS, Weighting::default()).unwrap());
    });
    group.finish();
}

fn benches(criterion: &mut Criterion) {
    levels(criterion);
    residual(criterion);
    build(criterion);
}

criterion_group!(all, benches);
criterion_main!(all);
