//! `tf_checkpoint_*/`: TensorFlow checkpoints.

use std::path::Path;

use burn::tensor::Device;
use cape::model::{release, tensorflow::Checkpoint};

use crate::{fixture::Fixture, network};

/// Reads every variable; a checkpoint of a reference network must equal it bit for bit, have its
/// configuration in its shapes, and give its outputs.
pub(crate) fn check(directory: &Path, device: &Device, report: &mut dyn FnMut(String)) {
    let checkpoint = Checkpoint::open(directory).unwrap();
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
    let released = release::Released::read(&checkpoint).unwrap();
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
}
