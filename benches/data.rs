//! Packing captures, and drawing training batches from packed data on disk.

#![allow(missing_docs)] // criterion's macro makes a public function

use std::{path::Path, sync::Arc};

use cape::{
    core::silent,
    data::{
        DisplacementStatistics, Loader, LoaderOptions, LoaderState, PackOptions, PackedSet,
        SequenceList, Split, SplitSpec, pack,
    },
    synth::{CaptureGenerator, Motion, SynthSpec, synthetic_body},
};
use criterion::{Criterion, criterion_group, criterion_main};

/// Captures of one synthetic person in the raw layout, and how to split them.
fn captures(raw: &Path) -> SplitSpec {
    let body = synthetic_body();
    let spec = SynthSpec {
        subjects: 1,
        frames_per_sequence: 44,
        motions: vec![Motion::WalkMarch, Motion::Squats, Motion::Soccer],
        ..SynthSpec::default()
    };
    let names = |motions: Vec<Motion>| SequenceList {
        sequences: motions.iter().map(|motion| motion.name().to_owned()).collect(),
        exclude: Vec::new(),
    };
    let split = SplitSpec {
        subjects: spec.subject_names(),
        outfits: spec.outfits.clone(),
        train: names(spec.train_motions()),
        test: names(spec.test_motions()),
        ..SplitSpec::default()
    };
    CaptureGenerator::new(&body, spec).unwrap().write(raw, &mut silent).unwrap();
    split
}

fn benches(criterion: &mut Criterion) {
    let directory = tempfile::tempdir().unwrap();
    let (raw, packed) = (directory.path().join("raw"), directory.path().join("packed"));
    let split = captures(&raw);
    let mut group = criterion.benchmark_group("data");
    group.sample_size(10);
    group.bench_function("packing 480 frames", |bencher| {
        let mut run = 0;
        bencher.iter(|| {
            run += 1;
            let out = directory.path().join(format!("packed_{run}"));
            pack(&raw, &out, &split, PackOptions::default(), &mut silent).unwrap();
            std::fs::remove_dir_all(out).unwrap();
        });
    });
    pack(&raw, &packed, &split, PackOptions::default(), &mut silent).unwrap();
    let statistics = Arc::new(DisplacementStatistics::from_packed(&packed, &mut silent).unwrap());
    let set = Arc::new(PackedSet::open(&packed, Split::Train).unwrap());
    let rows = statistics.training_rows(set.frames());
    let options = LoaderOptions { batch: 16, ..LoaderOptions::default() };
    let mut loader = Loader::new(set, statistics, rows, options, LoaderState::new(1)).unwrap();
    group.bench_function("loading both batches of a step, batch 16", |bencher| {
        bencher.iter(|| loader.step().unwrap());
    });
    group.finish();
}

criterion_group!(all, benches);
criterion_main!(all);
