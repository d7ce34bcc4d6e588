//! Comparing a body's silhouette with an image's, 512 pixels wide, by distances and softly.

#![allow(missing_docs)] // criterion's macro makes a public function

use cape::{
    fit::{
        PinholeCamera,
        silhouette::{SilhouetteEnergy, render},
    },
    synth::synthetic_body,
};
use criterion::{Criterion, criterion_group, criterion_main};
use glam::DVec3;

fn benches(criterion: &mut Criterion) {
    let body = synthetic_body();
    let placed = |right: f64| -> Vec<DVec3> {
        let rows = body.v_template.rows().into_iter();
        rows.map(|v| DVec3::new(v[0] + right, v[1] + 0.3, v[2] - 2.6)).collect()
    };
    let camera = PinholeCamera::new(512, 512, None).unwrap();
    let mask = render(&placed(0.02), &body.faces, &camera).unwrap().mask().clone();
    let vertices = placed(0.0);
    let mut group = criterion.benchmark_group("silhouette, 512");
    group.sample_size(20);
    let energy = || SilhouetteEnergy::new(&camera, &mask, None, 512, 0.005).unwrap();
    let mut ways = vec![("distances".to_owned(), energy())];
    for softness in [0.5, 1.0, 2.0] {
        ways.push((format!("soft, {softness} pixels"), energy().with_softness(softness).unwrap()));
    }
    for (name, energy) in &ways {
        let matched = energy.match_surface(&vertices, &body.faces).unwrap();
        group.bench_function(name, |bencher| {
            bencher.iter(|| {
                matched.evaluate(&vertices, 1.0, &mut vec![DVec3::ZERO; vertices.len()]).total()
            });
        });
    }
    group.bench_function("matching", |bencher| {
        bencher.iter(|| ways[0].1.match_surface(&vertices, &body.faces).unwrap());
    });
    group.finish();
}

criterion_group!(fit, benches);
criterion_main!(fit);
