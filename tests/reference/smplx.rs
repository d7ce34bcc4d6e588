//! Linear blend skinning against the reference implementation's inputs and outputs.

use std::path::Path;

use burn::tensor::{Device, FloatDType, Tensor, TensorData};
use cape::core::{ClothedSmpl, JointSource, Pose, Smpl, SmplInput, SmplModel, npy::Npz};
use ndarray::{ArrayD, Axis, Ix2};

/// Allowed distance in space, metres, and of gradients, relative to the largest.
const METRES: f64 = 1e-5;
/// Allowed when unposing in `f32`. A random body's blends are nearly singular at some vertices,
/// where rounding the posed vertices to `f32` moves the unposed ones by 1e-5 m already. In `f64`,
/// unposing is held to [`METRES`].
const UNPOSED_METRES: f64 = 1e-4;
const RELATIVE: f64 = 1e-4;

/// Checks a `…_model.npz` with the `…_io.npz` beside it: on the host, on the device, gradients, and
/// that unposing undoes posing.
pub(crate) fn check(model_path: &Path, device: &Device, report: &mut dyn FnMut(String)) {
    let model = SmplModel::load(model_path).unwrap();
    let io_path = model_path.to_string_lossy().replace("_model.npz", "_io.npz");
    let mut io = Io { npz: Npz::open(io_path).unwrap(), device: device.clone().autodiff() };

    let betas = io.tensor::<2>("betas").require_grad();
    let pose = io.tensor::<2>("pose").require_grad();
    let transl = io.tensor::<2>("transl").require_grad();
    let displacement = io.tensor::<3>("displacement").require_grad();
    let input = |clothes: Option<Tensor<3>>| SmplInput {
        betas: betas.clone(),
        pose: Pose::AxisAngle(pose.clone()),
        transl: transl.clone(),
        displacement: clothes,
    };
    let io_device = io.device.clone();
    let smpl = Smpl::new(&model, &io_device).unwrap();
    let clothed = ClothedSmpl::new(smpl.clone());

    let mut metres = host(&model, &mut io);
    let bare = smpl.forward(input(None)).unwrap();
    metres = metres.max(io.distance("vertices", bare.vertices.clone()));
    metres = metres.max(io.distance("joints", bare.joints));
    let release = clothed.clone().with_joints(JointSource::ClothedTemplate);
    let released = release.forward(input(Some(displacement.clone()))).unwrap();
    metres = metres.max(io.distance("clothed_release_vertices", released.vertices));
    metres = metres.max(io.distance("clothed_release_joints", released.joints));
    let dressed = clothed.forward(input(Some(displacement.clone()))).unwrap();
    metres = metres.max(io.distance("clothed_vertices", dressed.vertices.clone()));

    let mut unpose = |smpl: &Smpl| {
        let posed = smpl.forward(input(Some(displacement.clone()))).unwrap().vertices;
        let pose = Pose::AxisAngle(pose.clone());
        let canonical = smpl.unpose(posed, betas.clone(), pose, transl.clone()).unwrap();
        io.distance("displacement", canonical - smpl.rest_shape(betas.clone()).unwrap())
    };
    let unposed = unpose(&smpl);
    if io_device.supports_dtype(FloatDType::F64) {
        let double = Smpl::with_precision(&model, &io_device, FloatDType::F64).unwrap();
        metres = metres.max(unpose(&double));
    }
    assert!(metres <= METRES, "positions off by {metres:e} m");
    assert!(unposed <= UNPOSED_METRES, "unposing in f32 off by {unposed:e} m");

    let grads = (dressed.vertices * io.tensor("projection")).sum().backward();
    let relative = [
        io.deviation("grad_betas", betas.grad(&grads)),
        io.deviation("grad_pose", pose.grad(&grads)),
        io.deviation("grad_transl", transl.grad(&grads)),
        io.deviation("grad_displacement", displacement.grad(&grads)),
    ]
    .into_iter()
    .fold(0.0, f64::max);
    assert!(relative <= RELATIVE, "gradients off by {relative:e} of the largest");
    report(format!(
        "positions within {metres:.1e} m, unposing in f32 within {unposed:.1e} m, gradients within \
         {relative:.1e}"
    ));
}

/// Largest distance of the host's results, row by row.
fn host(model: &SmplModel, io: &mut Io) -> f64 {
    let (betas, pose, transl) = (io.array("betas"), io.array("pose"), io.array("transl"));
    let clothes = io.array("displacement");
    let expected = [io.array("vertices"), io.array("clothed_vertices"), io.array("joints")];
    let mut most: f64 = 0.0;
    for row in 0..betas.shape()[0] {
        let numbers = |array: &ArrayD<f64>| -> Vec<f64> {
            array.index_axis(Axis(0), row).iter().copied().collect()
        };
        let transl: [f64; 3] = numbers(&transl).try_into().unwrap();
        let worn =
            clothes.index_axis(Axis(0), row).to_owned().into_dimensionality::<Ix2>().unwrap();
        let (betas, pose) = (numbers(&betas), numbers(&pose));
        let bare = model.pose(&betas, &pose, transl, None).unwrap();
        let dressed = model.pose(&betas, &pose, transl, Some(&worn)).unwrap();
        let canonical = model.unpose(&dressed.vertices, &betas, &pose, transl).unwrap();
        let clothes = canonical - model.rest_shape(&betas).unwrap();
        most =
            most.max(largest(clothes.iter().copied(), &worn.iter().copied().collect::<Vec<_>>()));
        for (found, expected) in
            [bare.vertices, dressed.vertices, bare.joints].iter().zip(&expected)
        {
            most = most.max(largest(found.iter().copied(), &numbers(expected)));
        }
    }
    most
}

struct Io {
    npz: Npz,
    device: Device,
}

impl Io {
    fn array(&mut self, name: &str) -> ArrayD<f64> {
        self.npz.f64(name).unwrap()
    }

    fn tensor<const D: usize>(&mut self, name: &str) -> Tensor<D> {
        let array = self.npz.f32(name).unwrap();
        let shape: [usize; D] = array.shape().try_into().unwrap();
        Tensor::from_data(TensorData::new(array.into_iter().collect(), shape), &self.device)
    }

    /// Largest difference from the array `name` in any coordinate.
    fn distance<const D: usize>(&mut self, name: &str, found: Tensor<D>) -> f64 {
        let expected = self.array(name);
        assert_eq!(found.dims().as_slice(), expected.shape(), "{name}");
        let found = found.inner().try_into_vec_as::<f64>().unwrap();
        let expected: Vec<f64> = expected.into_iter().collect();
        largest(found.into_iter(), &expected)
    }

    /// The same, relative to the largest number of the array.
    fn deviation<const D: usize>(&mut self, name: &str, gradient: Option<Tensor<D>>) -> f64 {
        let gradient = gradient.unwrap_or_else(|| panic!("{name}: no gradient"));
        let expected = self.array(name);
        let found = gradient.try_into_vec_as::<f32>().unwrap();
        let expected: Vec<f64> = expected.into_iter().collect();
        let scale = expected.iter().fold(f64::MIN_POSITIVE, |most, x| most.max(x.abs()));
        largest(found.into_iter().map(f64::from), &expected) / scale
    }
}

/// Largest absolute difference; infinite if a number is not finite or the lengths differ.
fn largest(found: impl ExactSizeIterator<Item = f64>, expected: &[f64]) -> f64 {
    if found.len() != expected.len() {
        return f64::INFINITY;
    }
    found.zip(expected).fold(0.0, |most, (found, expected)| {
        let difference = (found - expected).abs();
        if difference.is_finite() { most.max(difference) } else { f64::INFINITY }
    })
}
