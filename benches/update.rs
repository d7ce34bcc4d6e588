//! One update of generator and discriminator, encoding, decoding and discriminating, on 6890
//! vertices.

#![allow(missing_docs)] // criterion's macro makes a public function

use std::time::Duration;

use burn::tensor::Device;
use cape::{eval::bench::Workload, model::CapeConfig};
use criterion::{Criterion, criterion_group, criterion_main};

const BATCH: usize = 16;
const SEED: u64 = 1;

fn workload(config: &CapeConfig) -> Workload {
    Workload::new(config, BATCH, SEED, &Device::flex()).unwrap()
}

fn update(criterion: &mut Criterion, name: &str, config: &CapeConfig) {
    let mut workload = workload(config);
    let mut group = criterion.benchmark_group("update");
    group.sample_size(10).warm_up_time(Duration::from_secs(3));
    group.bench_function(name, |bencher| bencher.iter(|| workload.update().unwrap()));
    group.finish();
}

fn inference(criterion: &mut Criterion) {
    let workload = workload(&CapeConfig::paper());
    let mut group = criterion.benchmark_group("inference");
    group.sample_size(10);
    for batch in [1, BATCH] {
        let model = workload.inference(batch);
        group.bench_function(format!("decode batch {batch}"), |bencher| {
            bencher.iter(|| model.decode().unwrap());
        });
    }
    let model = workload.inference(BATCH);
    group.bench_function(format!("encode batch {BATCH}"), |bencher| {
        bencher.iter(|| model.encode().unwrap());
    });
    group.bench_function(format!("discriminate batch {BATCH}"), |bencher| {
        bencher.iter(|| model.discriminate().unwrap());
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
