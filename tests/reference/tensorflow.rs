//! `tf_checkpoint_*/`: TensorFlow checkpoints.

use std::path::Path;

use burn::tensor::Device;
use cape::{
    core::{
        SmplModel,
        joints::{JOINTS, PARENTS},
        npy::{NpzWriter, write_npy},
    },
    infer::Run,
    model::{release, tensorflow::TensorFlowCheckpoint},
    train::release::ImportOptions,
};
use ndarray::{Array1, Array2, Array3};

use crate::{
    fixture::{Fixture, deviation},
    network,
};

/// Allowed deviation where the pyramid is our own, relative to the norm.
const IMPORTED: f64 = 1e-4;

/// Reads every variable; a checkpoint of a reference network must equal it bit for bit, have its
/// configuration in its shapes, and give its outputs.
pub(crate) fn check(directory: &Path, device: &Device, report: &mut dyn FnMut(String)) {
    let checkpoint = TensorFlowCheckpoint::open(directory).unwrap();
    let (mut numbers, mut integers) = (0, 0);
    for variable in checkpoint.variables() {
        if variable.element.is_float() {
            let array = checkpoint.floats(variable).unwrap();
            assert_eq!(array.values.len(), variable.shape.iter().product::<usize>());
            numbers += array.values.len();
        } else {
            integers += checkpoint.integers(variable).unwrap().len();
        }
    }
    report(format!(
        "{} variables, {numbers} floating point numbers, {integers} integers",
        checkpoint.variables().len()
    ));
    let name = directory.file_name().unwrap().to_string_lossy();
    let network_name = format!("network_{}.npz", name.trim_start_matches("tf_checkpoint_"));
    let path = directory.with_file_name(&network_name);
    if !path.is_file() {
        report(format!("no {network_name} beside it to compare with"));
        return;
    }
    let mut fixture = Fixture::open(&path, &device.clone().autodiff());
    let released = release::ReleaseCheckpoint::read(&checkpoint).unwrap();
    assert_eq!(released.variables.len(), fixture.variables.len());
    for (theirs, expected) in &fixture.variables {
        let bare = theirs.trim_end_matches(":0");
        let found = released.variables.iter().find(|(name, _)| name == bare);
        let (_, found) = found.unwrap_or_else(|| panic!("{theirs} is missing"));
        assert_eq!(found.shape, expected.shape, "{theirs}");
        let bits = |values: &[f32]| values.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&found.values), bits(&expected.values), "{theirs}");
    }
    let inferred = release::infer(&released.shapes()).unwrap();
    assert_eq!(inferred, fixture.config, "configuration");
    let slots = released.momentum(&inferred, "generator").unwrap().len()
        + released.momentum(&inferred, "discriminator").unwrap().len();
    report(format!(
        "equals {network_name} bit for bit; {slots} velocities, step {:?}",
        released.step
    ));
    fixture.variables = released.variables;
    let model = network::build(&fixture);
    network::outputs(&mut fixture, &model, report);
    import(directory, &mut fixture, device, report);
}

/// The whole way of a user: the checkpoint made into a run, with a pyramid of our own.
fn import(
    directory: &Path,
    fixture: &mut Fixture,
    device: &Device,
    report: &mut dyn FnMut(String),
) {
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name);
    let body = body_of(fixture);
    let (v, sizes) = (body.vertices(), (body.vertices(), 3));
    body.save(at("body.npz")).unwrap();
    let mut statistics = NpzWriter::create(at("stats.npz")).unwrap();
    statistics.add("mean", &Array2::<f64>::zeros(sizes)).unwrap();
    statistics.add("std", &Array2::<f64>::ones(sizes)).unwrap();
    statistics.finish().unwrap();
    write_npy(at("clothing.npy"), &Array1::from_iter(0..v as i64)).unwrap();
    let discriminator = fixture.config.discriminator.as_ref();
    let options = ImportOptions {
        body: at("body.npz"),
        statistics: at("stats.npz"),
        clothing: Some(at("clothing.npy")),
        factors: Some(fixture.config.factors.clone()),
        discriminator_factors: discriminator.map(|d| d.factors.clone()),
        settings: None,
    };
    let out = at("run");
    cape::train::release::import(directory, &options, &out, device).unwrap();
    let run = Run::open(&out, device).unwrap();
    fixture.device = device.clone();
    let (z, feature, outfit) =
        (fixture.tensor("out/z_sample"), fixture.tensor("in/cond_g"), fixture.tensor("in/cond2_g"));
    let decoded = run.generator().decode(z, feature, outfit, run.graphs());
    let found: Vec<f32> = decoded.into_data().try_into_vec().unwrap();
    let off = deviation(&found, &fixture.values("out/x_hat"));
    assert!(off < IMPORTED, "imported run: x_hat off by {off:.1e} of its norm");
    report(format!("imported as a run on our own pyramid: x_hat within {off:.1e} of its norm"));
}

/// A body whose template is the network's mesh.
fn body_of(fixture: &mut Fixture) -> SmplModel {
    let v_template: Array2<f64> = fixture.npz.f64("mesh/v").unwrap().into_dimensionality().unwrap();
    let v = v_template.nrows();
    let faces: Vec<u32> = fixture.npz.get("mesh/f").unwrap().into_iter().collect();
    let one_joint = |row: usize, column: usize| f64::from(row % JOINTS == column);
    SmplModel {
        shapedirs: Array3::zeros((v, 3, 1)),
        posedirs: Array3::zeros((v, 3, 9 * (JOINTS - 1))),
        joint_regressor: Array2::from_shape_fn((JOINTS, v), |(j, vertex)| f64::from(j == vertex)),
        weights: Array2::from_shape_fn((v, JOINTS), |(vertex, j)| one_joint(vertex, j)),
        parents: PARENTS.to_vec(),
        faces: faces.as_chunks::<3>().0.to_vec(),
        v_template,
    }
}
