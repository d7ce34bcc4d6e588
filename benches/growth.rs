//! Time of an update over batch size and mesh size: examples times vertices a second, which
//! stay the same where time is linear in both.

#![allow(missing_docs)] // criterion's macro makes a public function

use std::{collections::HashMap, time::Duration};

use burn::tensor::Device;
use cape::{
    eval::bench::Workload,
    graph::{MeshPyramid, Surface, Weighting},
    model::CapeConfig,
    synth::synthetic_body,
};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};

const BATCH: usize = 16;
const SEED: u64 = 1;

/// Every triangle in four.
fn subdivide(surface: &Surface) -> Surface {
    let mut fine = Surface { vertices: surface.vertices.clone(), faces: Vec::new() };
    let mut middles = HashMap::new();
    for &[a, b, c] in &surface.faces {
        let [ab, bc, ca] = [[a, b], [b, c], [c, a]].map(|[a, b]| {
            *middles.entry([a.min(b), a.max(b)]).or_insert_with(|| {
                let [a, b] = [a, b].map(|v| surface.vertices[v as usize]);
                fine.vertices.push(std::array::from_fn(|i| f64::midpoint(a[i], b[i])));
                fine.vertices.len() as u32 - 1
            })
        });
        fine.faces.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
    }
    fine
}

/// The body with fewer and with more vertices.
fn surfaces(body: &Surface) -> Vec<Surface> {
    let pyramid = MeshPyramid::build(body, &[2.0, 2.0, 2.0, 2.0], Weighting::default()).unwrap();
    let mut surfaces: Vec<Surface> =
        pyramid.levels().iter().rev().map(|level| level.surface().clone()).collect();
    surfaces.push(subdivide(body));
    surfaces
}

fn benches(criterion: &mut Criterion) {
    let config = CapeConfig::paper();
    let body = Surface::from(&synthetic_body());
    let mut group = criterion.benchmark_group("growth");
    group.sample_size(10).warm_up_time(Duration::from_secs(1));
    let mut run = |name: String, surface: &Surface, batch: usize| {
        let mut workload =
            Workload::on_mesh(&config, surface, batch, SEED, &Device::flex()).unwrap();
        group.throughput(Throughput::Elements((batch * surface.vertices.len()) as u64));
        group.bench_function(name, |bencher| bencher.iter(|| workload.update().unwrap()));
    };
    for batch in [1, 2, 4, 8, 16, 32] {
        run(format!("batch {batch}"), &body, batch);
    }
    for surface in surfaces(&body) {
        run(format!("{} vertices", surface.vertices.len()), &surface, BATCH);
    }
    group.finish();
}

criterion_group!(all, benches);
criterion_main!(all);
