//! Devices, seeded inputs, and execution of an operation with its gradients.

use burn::tensor::{Device, Tensor, TensorData};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use sprs::{CsMat, TriMat};

use crate::host;

/// Devices of `CAPE_TEST_DEVICES` (names separated by commas), or every CPU device compiled in.
pub(crate) fn devices() -> Vec<(String, Device)> {
    let names = std::env::var("CAPE_TEST_DEVICES").unwrap_or_else(|_| {
        let cpu = |name: &&&str| is_cpu(name);
        cape_core::DEVICES.iter().filter(cpu).copied().collect::<Vec<_>>().join(",")
    });
    let names = names.split(',').filter(|name| !name.is_empty());
    let devices: Vec<_> = names
        .map(|name| {
            let device = cape_core::parse_device(name).unwrap_or_else(|error| panic!("{error}"));
            (name.to_owned(), device)
        })
        .collect();
    assert!(
        !devices.is_empty(),
        "no CPU device is compiled in: name one of {:?} in CAPE_TEST_DEVICES",
        cape_core::DEVICES
    );
    devices
}

/// Tested devices with this crate's CPU kernels.
pub(crate) fn cpu_devices() -> Vec<(String, Device)> {
    devices().into_iter().filter(|(name, _)| is_cpu(name)).collect()
}

pub(crate) fn is_cpu(name: &str) -> bool {
    ["flex", "ndarray"].contains(&name)
}

/// Uniform values in `[-1, 1)`, exactly representable in f32.
pub(crate) fn random(seed: u64, len: usize) -> Vec<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..len).map(|_| f64::from(rng.random_range(-1.0f32..1.0))).collect()
}

/// Matrix with about `per_row` entries in each row, row sums of magnitudes up to 1, and an empty last
/// column; if `gaps`, every third row is empty as well.
pub(crate) fn sparse(
    seed: u64,
    rows: usize,
    cols: usize,
    per_row: usize,
    gaps: bool,
) -> CsMat<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut matrix = TriMat::new((rows, cols));
    for row in (0..rows).filter(|row| !gaps || row % 3 != 0) {
        for _ in 0..per_row {
            let value = rng.random_range(-1.0f32..1.0) / per_row as f32;
            matrix.add_triplet(row, rng.random_range(0..cols.max(2) - 1), f64::from(value));
        }
    }
    matrix.to_csr()
}

/// Operation on flat inputs, which it reshapes.
pub(crate) type Op<'a> = &'a (dyn Fn(&[Tensor<1>]) -> Tensor<3> + Sync);

/// Output of an operation, and the gradients of its inner product with [`probe`].
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Outcome {
    pub output: Vec<f32>,
    pub gradients: Vec<Option<Vec<f32>>>,
}

/// Factors of the outputs in the loss, which is their weighted sum, `[len]`.
pub(crate) fn probe(len: usize) -> Vec<f64> {
    random(0xface, len)
}

/// Output of `op`, and the gradients of its `tracked` inputs.
pub(crate) fn run(device: &Device, inputs: &[Vec<f64>], tracked: &[bool], op: Op) -> Outcome {
    let device = device.clone().autodiff();
    let inputs: Vec<Tensor<1>> = inputs
        .iter()
        .zip(tracked)
        .map(|(values, &tracked)| {
            let input = upload(values, [values.len()], &device);
            if tracked { input.require_grad() } else { input }
        })
        .collect();
    let output = op(&inputs);
    let probe = upload(&probe(output.shape().num_elements()), output.dims(), &device);
    let gradients = (output.clone() * probe).sum().backward();
    Outcome {
        output: values(output),
        gradients: inputs.iter().map(|input| Some(values(input.grad(&gradients)?))).collect(),
    }
}

pub(crate) fn upload<const D: usize>(
    values: &[f64],
    shape: [usize; D],
    device: &Device,
) -> Tensor<D> {
    let values: Vec<f32> = values.iter().map(|&value| value as f32).collect();
    Tensor::from_data(TensorData::new(values, shape), device)
}

pub(crate) fn values<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().try_into_vec().unwrap()
}

/// Asserts that `actual` equals `expected` within `tolerance` times its largest magnitude.
pub(crate) fn assert_close(label: &str, actual: &[f32], expected: &[f64], tolerance: f64) {
    assert_eq!(actual.len(), expected.len(), "{label}: lengths");
    let scale = expected.iter().fold(0.0f64, |scale, value| scale.max(value.abs())).max(1e-3);
    for (i, (&actual, &expected)) in actual.iter().zip(expected).enumerate() {
        let error = (f64::from(actual) - expected).abs();
        assert!(
            error <= tolerance * scale,
            "{label}: [{i}] is {actual} instead of {expected}, off by {:.1e} of {scale:.1e}",
            error / scale
        );
    }
}

/// Asserts that output and gradients of two implementations agree.
pub(crate) fn assert_agree(label: &str, actual: &Outcome, expected: &Outcome, tolerance: f64) {
    let wide = |values: &[f32]| -> Vec<f64> { values.iter().map(|&x| f64::from(x)).collect() };
    assert_close(&format!("{label}: output"), &actual.output, &wide(&expected.output), tolerance);
    for (i, (actual, expected)) in actual.gradients.iter().zip(&expected.gradients).enumerate() {
        let label = format!("{label}: gradient {i}");
        match (actual, expected) {
            (Some(actual), Some(expected)) => {
                assert_close(&label, actual, &wide(expected), tolerance);
            }
            (None, None) => {}
            _ => panic!("{label}: only one of the two has it"),
        }
    }
}

/// Asserts that an outcome agrees with the host in double precision and with central differences.
pub(crate) fn assert_host(
    label: &str,
    actual: &Outcome,
    inputs: &[Vec<f64>],
    op: &dyn Fn(&[Vec<f64>]) -> Vec<f64>,
) {
    assert_close(&format!("{label}: output"), &actual.output, &op(inputs), 2e-6);
    let expected = host::gradients(inputs, op);
    for (i, (actual, expected)) in actual.gradients.iter().zip(&expected).enumerate() {
        let label = format!("{label}: gradient {i}");
        let actual = actual.as_ref().unwrap_or_else(|| panic!("{label} is missing"));
        assert_close(&label, actual, expected, 1e-5);
    }
}

/// Asserts that output and gradients do not depend on which other inputs are tracked.
pub(crate) fn assert_partial_tracking(label: &str, device: &Device, inputs: &[Vec<f64>], op: Op) {
    let all = run(device, inputs, &vec![true; inputs.len()], op);
    for subset in 1..(1 << inputs.len()) - 1 {
        let tracked: Vec<bool> = (0..inputs.len()).map(|i| subset >> i & 1 == 1).collect();
        let mut expected = all.clone();
        for (gradient, &tracked) in expected.gradients.iter_mut().zip(&tracked) {
            gradient.take_if(|_| !tracked);
        }
        let label = format!("{label}: tracking {tracked:?}");
        assert_agree(&label, &run(device, inputs, &tracked, op), &expected, 1e-6);
    }
}
