//! Pictures of 512×512 of a body of 6890 vertices.

#![allow(missing_docs)] // criterion's macro makes a public function

use cape::{
    render::{Bounds, Camera, Object, Projection, Style, View, render, silhouette},
    synth::synthetic_body,
};
use criterion::{Criterion, criterion_group, criterion_main};

fn benches(criterion: &mut Criterion) {
    let mesh = synthetic_body().mesh();
    let bounds = Bounds::from_meshes([&mesh]).unwrap();
    let camera = Camera::framing(&bounds, View::ThreeQuarter, Projection::default(), 1.0);
    let mut group = criterion.benchmark_group("512×512");
    let full = Style::default();
    for (name, style) in [
        ("as pictures are drawn", full),
        ("without shadows", Style { shadows: false, floor: false, ..full }),
        ("one sample a pixel", Style { samples: 1, ..full }),
    ] {
        group.bench_function(name, |bencher| {
            bencher.iter(|| render(&[Object::new(&mesh)], &camera, &style).unwrap());
        });
    }
    group.bench_function("silhouette", |bencher| {
        bencher.iter(|| silhouette(&mesh, &camera, 512, 512).unwrap());
    });
    group.finish();
}

criterion_group!(all, benches);
criterion_main!(all);
