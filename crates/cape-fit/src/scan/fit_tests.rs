use super::*;
use crate::{
    clothed_tests::{dressed, truth},
    scan::Unit,
    testing::BODY,
};

fn fitter(config: ScanConfig) -> ScanFitter {
    ScanFitter {
        body: BODY.clone(),
        skeleton: Skeleton::new(&BODY).unwrap(),
        prior: PosePrior::synthetic().unwrap(),
        outfits: vec![dressed(Outfit::LONG_SHORT)],
        mean_clothes: Array2::zeros(BODY.v_template.dim()),
        shape_is_known: false,
        config,
    }
}

/// Vertices of the true clothed body, as a point cloud.
fn scan(fitter: &ScanFitter) -> (Scan, Vec<DVec3>) {
    let (body, code) = truth();
    let surface = fitter.outfits[0].surface(&body, &code).unwrap();
    let vertices = surface.vertices().to_vec();
    (Scan::new(vertices.clone(), None, Vec::new(), Unit::M).unwrap(), vertices)
}

/// All terms together, over translation, pose, shape and code.
#[test]
fn gradients_of_the_energy_agree_with_finite_differences() {
    let fitter = fitter(ScanConfig::default());
    let (scan, _) = scan(&fitter);
    let target = ScanTarget::new(&scan, 1500, 1);
    let start = ScanInit::Poses(Vec::new());
    let (body, code) = truth();
    let betas = body.betas.len();
    let problem = ScanProblem {
        fitter: &fitter,
        dressed: &fitter.outfits[0],
        clothes: None,
        target: &target,
        start: &start,
        betas,
    };
    let mut x = [body.to_vector(), code].concat();
    for (at, value) in x.iter_mut().enumerate() {
        *value += 0.02 * (1.7 * at as f64 + 0.4).sin();
    }
    let stage = ScanStage { samples: 1500, robust_scale: 0.1, ..fitter.config.stages[3] };
    let distances = problem.distances(&x, &stage).unwrap();
    let total = |x: &[f64], gradient: &mut [f64]| {
        let terms = problem.evaluate(x, &distances, stage.distance, gradient).unwrap();
        terms.body.weighted(&fitter.config.body)
            + stage.distance * distances.total(&terms.distance)
            + fitter.config.code * terms.code
    };
    let mut found = vec![0.0; x.len()];
    total(&x, &mut found);
    let step = 2e-3;
    let codes = BETAS_AT + betas;
    for (name, all, every, tolerance) in [
        ("translation", 0..3, 1, 0.03),
        ("pose", 3..BETAS_AT, 4, 0.03),
        ("shape", BETAS_AT..codes, 1, 0.03),
        ("code", codes..x.len(), 1, 0.15),
    ] {
        let scale = found[all.clone()].iter().fold(0.0f64, |most, g| most.max(g.abs()));
        for at in all.step_by(every) {
            let value = |change: f64| {
                let mut x = x.clone();
                x[at] += change;
                total(&x, &mut vec![0.0; x.len()])
            };
            let expected = (value(step) - value(-step)) / (2.0 * step);
            let off = (found[at] - expected).abs();
            assert!(off < tolerance * scale, "{name} {at}: {} {expected} {scale}", found[at]);
        }
    }
}

#[test]
fn a_clothed_body_is_found_in_its_points() {
    let fitter = fitter(ScanConfig {
        stages: vec![
            ScanStage::new(Unknowns::Pose, 0.2, 500, 12, 1e5),
            ScanStage::new(Unknowns::Shape, 0.1, 500, 12, 1e6),
            ScanStage::new(Unknowns::Clothes, 0.03, 2000, 15, 3e6),
        ],
        starts: 1,
        betas: 2,
        ..ScanConfig::default()
    });
    let (scan, truth) = scan(&fitter);
    let start = ScanInit::default_poses(&fitter.prior);
    let mut heard = Vec::new();
    let fit =
        fitter.fit(&scan, &start, UpAxis::Y, &mut |done, total| heard.push((done, total))).unwrap();
    assert!(fit.problem.is_none(), "{:?}", fit.problem);
    assert!(fit.distance.mean < 12.0, "{:?}", fit.distance);
    let surface = fitter.surface(&fit).unwrap();
    let off: f64 = surface.iter().zip(&truth).map(|(a, b)| a.distance(*b)).sum();
    assert!(off / (truth.len() as f64) < 0.05, "{}", off / truth.len() as f64);
    assert!(heard.is_sorted() && heard.last().is_some_and(|(done, total)| done == total));
    assert!(fit.curves.iter().all(|curve| curve.windows(2).all(|pair| pair[1] <= pair[0])));
}
