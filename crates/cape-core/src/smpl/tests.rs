//! Tensor operations compared with the independent implementation on the host in `f64`.

use std::f64::consts::PI;

use burn::tensor::{Device, FloatDType, Tensor, TensorData};
use ndarray::{Array, Array1, Array2, Array3, ArrayRef, Dimension, s};
use rand::{SeedableRng, rngs::ChaCha8Rng};

use super::{
    test_model::{random, random_model},
    *,
};
use crate::{devices, joints::pose_rotations};

const BATCH: usize = 4;

/// Inputs of a batch on the host.
struct Inputs {
    betas: Array2<f64>,
    pose: Array2<f64>,
    transl: Array2<f64>,
    displacement: Array3<f64>,
    /// Weights of the vertices in the scalar whose gradients are compared.
    projection: Array3<f64>,
}

/// Row 0 has zero pose, row 1 a rotation near π, row 2 tiny angles.
fn inputs() -> Inputs {
    let rng = &mut ChaCha8Rng::seed_from_u64(3);
    let mut pose = random((BATCH, 12), 1.0, rng);
    pose.row_mut(0).fill(0.0);
    pose.slice_mut(s![1, 3..6]).assign(&ndarray::array![0.0, PI - 1e-4, 0.0]);
    pose.row_mut(2).mapv_inplace(|x| x * 1e-4);
    Inputs {
        betas: random((BATCH, 2), 1.0, rng),
        pose,
        transl: random((BATCH, 3), 1.0, rng),
        displacement: random((BATCH, 12, 3), 0.05, rng),
        projection: random((BATCH, 12, 3), 1.0, rng),
    }
}

fn tensor<const D: usize, N: Dimension>(array: &ArrayRef<f64, N>, device: &Device) -> Tensor<D> {
    let values: Vec<f32> = array.iter().map(|&value| value as f32).collect();
    let shape: [usize; D] = array.shape().try_into().unwrap();
    Tensor::from_data(TensorData::new(values, shape), device)
}

fn numbers<const D: usize>(tensor: Tensor<D>) -> Vec<f64> {
    tensor.try_into_vec_as::<f32>().unwrap().into_iter().map(f64::from).collect()
}

fn assert_close<N: Dimension>(what: &str, found: &[f64], expected: &ArrayRef<f64, N>, within: f64) {
    assert_eq!(found.len(), expected.len(), "{what}");
    let most = found.iter().zip(expected).fold(0.0f64, |m, (f, e)| m.max((f - e).abs()));
    assert!(most <= within, "{what}: off by {most:e}, allowed {within:e}");
}

impl Inputs {
    fn input(&self, device: &Device) -> SmplInput {
        SmplInput {
            betas: tensor(&self.betas, device),
            pose: Pose::AxisAngle(tensor(&self.pose, device)),
            transl: tensor(&self.transl, device),
            displacement: Some(tensor(&self.displacement, device)),
        }
    }

    fn transl(&self, row: usize) -> [f64; 3] {
        [self.transl[[row, 0]], self.transl[[row, 1]], self.transl[[row, 2]]]
    }

    fn posed(&self, model: &SmplModel, row: usize) -> PosedBody {
        let clothes = self.displacement.slice(s![row, .., ..]).to_owned();
        let (betas, pose) = (self.betas.row(row).to_vec(), self.pose.row(row).to_vec());
        model.pose(&betas, &pose, self.transl(row), Some(&clothes)).unwrap()
    }

    /// Σ posed vertices · projection.
    fn scalar(&self, model: &SmplModel) -> f64 {
        let row = |row| {
            let weights = self.projection.slice(s![row, .., ..]);
            (&self.posed(model, row).vertices * &weights).sum()
        };
        (0..BATCH).map(row).sum()
    }
}

/// Central differences of `scalar` with respect to the numbers of `field`.
fn differences<S, N: Dimension>(
    state: &mut S,
    field: impl Fn(&mut S) -> &mut Array<f64, N>,
    scalar: impl Fn(&S) -> f64,
) -> Array1<f64> {
    let step = 1e-6;
    let count = field(state).len();
    let mut derivative = |at: usize| {
        let mut value = |change: f64| {
            *field(state).iter_mut().nth(at).unwrap() += change;
            let value = scalar(state);
            *field(state).iter_mut().nth(at).unwrap() -= change;
            value
        };
        (value(step) - value(-step)) / (2.0 * step)
    };
    (0..count).map(&mut derivative).collect()
}

#[test]
fn posing_agrees_with_the_host() {
    let (model, inputs) = (random_model(), inputs());
    for device in devices() {
        let smpl = Smpl::new(&model, &device).unwrap();
        let output = smpl.forward(inputs.input(&device)).unwrap();
        let rotations: Vec<f64> = inputs
            .pose
            .rows()
            .into_iter()
            .flat_map(|row| pose_rotations(&row.to_vec()).unwrap())
            .flat_map(|r| r.as_flattened().to_vec())
            .collect();
        let rotations = Array::from_shape_vec((BATCH, 4, 3, 3), rotations).unwrap();
        let by_matrices = SmplInput {
            pose: Pose::Rotations(tensor(&rotations, &device)),
            ..inputs.input(&device)
        };
        let by_matrices = smpl.forward(by_matrices).unwrap();
        for (row, (v, j)) in
            [(output.vertices, output.joints), (by_matrices.vertices, by_matrices.joints)]
                .into_iter()
                .flat_map(|(v, j)| {
                    (0..BATCH).map(move |row| {
                        (row, (v.clone().narrow(0, row, 1), j.clone().narrow(0, row, 1)))
                    })
                })
        {
            let expected = inputs.posed(&model, row);
            assert_close("vertices", &numbers(v), &expected.vertices, 2e-6);
            assert_close("joints", &numbers(j), &expected.joints, 2e-6);
        }
    }
}

#[test]
fn stages_agree_with_the_host_and_missing_betas_are_zero() {
    let (model, inputs) = (random_model(), inputs());
    for device in devices() {
        let smpl = Smpl::new(&model, &device).unwrap();
        for count in 0..=2 {
            let betas = inputs.betas.slice(s![3..4, ..count]).to_owned();
            let pose = inputs.pose.slice(s![3..4, ..]).to_owned();
            let (b, p) = (betas.row(0).to_vec(), pose.row(0).to_vec());
            let betas = match count {
                0 => Tensor::<2>::zeros([1, 0], &device),
                _ => tensor(&betas, &device),
            };
            let shape = model.rest_shape(&b).unwrap();
            assert_close("shape", &numbers(smpl.rest_shape(betas.clone()).unwrap()), &shape, 1e-6);
            let joints = smpl.rest_joints(betas.clone()).unwrap();
            assert_close("joints", &numbers(joints), &model.rest_joints(&shape).unwrap(), 1e-6);
            let joints =
                smpl.regress_joints(tensor(&shape.clone().insert_axis(ndarray::Axis(0)), &device));
            assert_close(
                "regressed",
                &numbers(joints.unwrap()),
                &model.rest_joints(&shape).unwrap(),
                1e-6,
            );
            let unposed =
                smpl.unposed_template(betas, Pose::AxisAngle(tensor(&pose, &device))).unwrap();
            assert_close(
                "unposed",
                &numbers(unposed),
                &model.unposed_template(&b, &p).unwrap(),
                1e-6,
            );
        }
    }
}

#[test]
fn gradients_agree_with_finite_differences() {
    let (model, mut inputs) = (random_model(), inputs());
    let expected = [
        ("betas", differences(&mut inputs, |i| &mut i.betas, |i| i.scalar(&model))),
        ("pose", differences(&mut inputs, |i| &mut i.pose, |i| i.scalar(&model))),
        ("transl", differences(&mut inputs, |i| &mut i.transl, |i| i.scalar(&model))),
        ("displacement", differences(&mut inputs, |i| &mut i.displacement, |i| i.scalar(&model))),
    ];
    for device in devices().into_iter().map(Device::autodiff) {
        let smpl = Smpl::new(&model, &device).unwrap();
        let betas = tensor::<2, _>(&inputs.betas, &device).require_grad();
        let pose = tensor::<2, _>(&inputs.pose, &device).require_grad();
        let transl = tensor::<2, _>(&inputs.transl, &device).require_grad();
        let displacement = tensor::<3, _>(&inputs.displacement, &device).require_grad();
        let output = smpl
            .forward(SmplInput {
                betas: betas.clone(),
                pose: Pose::AxisAngle(pose.clone()),
                transl: transl.clone(),
                displacement: Some(displacement.clone()),
            })
            .unwrap();
        let grads = (output.vertices * tensor(&inputs.projection, &device)).sum().backward();
        let found = [
            numbers(betas.grad(&grads).unwrap()),
            numbers(pose.grad(&grads).unwrap()),
            numbers(transl.grad(&grads).unwrap()),
            numbers(displacement.grad(&grads).unwrap()),
        ];
        for ((name, expected), found) in expected.iter().zip(found) {
            let scale = expected.iter().fold(0.0f64, |m, x| m.max(x.abs()));
            assert_close(name, &found, expected, 1e-5 * scale);
        }
    }
}

#[test]
fn unposing_undoes_posing_and_its_gradient_agrees() {
    struct State {
        posed: Array2<f64>,
        pose: Array1<f64>,
    }
    let (model, inputs) = (random_model(), inputs());
    let row = 2;
    let betas = inputs.betas.row(row).to_vec();
    let transl = inputs.transl(row);
    let weights = inputs.projection.slice(s![row, .., ..]).to_owned();
    let pose = inputs.pose.row(3).mapv(|x| 0.5 * x);
    let clothes = inputs.displacement.slice(s![row, .., ..]).to_owned();
    let posed = model.pose(&betas, &pose.to_vec(), transl, Some(&clothes)).unwrap().vertices;
    let mut state = State { posed, pose };
    let scalar = |state: &State| {
        let rest = model.unpose(&state.posed, &betas, &state.pose.to_vec(), transl).unwrap();
        (rest * &weights).sum()
    };
    let by_vertex = differences(&mut state, |state| &mut state.posed, scalar);
    let by_pose = differences(&mut state, |state| &mut state.pose, scalar);
    let batch = |array: &Array2<f64>| array.clone().insert_axis(ndarray::Axis(0));
    for device in devices().into_iter().map(Device::autodiff) {
        let smpl = Smpl::new(&model, &device).unwrap();
        let posed = tensor::<3, _>(&batch(&state.posed), &device).require_grad();
        let pose = state.pose.clone().insert_axis(ndarray::Axis(0));
        let pose = tensor::<2, _>(&pose, &device).require_grad();
        let rest = smpl
            .unpose(
                posed.clone(),
                tensor(&inputs.betas.slice(s![row..=row, ..]).to_owned(), &device),
                Pose::AxisAngle(pose.clone()),
                tensor(&inputs.transl.slice(s![row..=row, ..]).to_owned(), &device),
            )
            .unwrap();
        let expected = model.rest_shape(&betas).unwrap() + &clothes;
        assert_close("canonical", &numbers(rest.clone().inner()), &expected, 1e-5);
        let grads = (rest * tensor(&batch(&weights), &device)).sum().backward();
        for (name, found, expected) in [
            ("posed", numbers(posed.grad(&grads).unwrap()), &by_vertex),
            ("pose", numbers(pose.grad(&grads).unwrap()), &by_pose),
        ] {
            let scale = expected.iter().fold(0.0f64, |m, x| m.max(x.abs()));
            assert_close(name, &found, expected, 1e-4 * scale);
        }
    }
}

#[test]
fn clothes_follow_the_mask_and_the_joint_source() {
    let (model, inputs) = (random_model(), inputs());
    let mask = ClothingMask::from_indices(12, &[0, 1, 2, 3, 4]).unwrap();
    for device in devices() {
        let clothed = ClothedSmpl::new(Smpl::new(&model, &device).unwrap());
        let bare_joints =
            model.rest_joints(&model.rest_shape(&inputs.betas.row(0).to_vec()).unwrap());
        let masked =
            clothed.clone().with_mask(&mask).unwrap().forward(inputs.input(&device)).unwrap();
        for row in 0..BATCH {
            let mut clothes = inputs.displacement.slice(s![row, .., ..]).to_owned();
            clothes.slice_mut(s![5.., ..]).fill(0.0);
            let (betas, pose) = (inputs.betas.row(row).to_vec(), inputs.pose.row(row).to_vec());
            let expected = model.pose(&betas, &pose, inputs.transl(row), Some(&clothes)).unwrap();
            let found = numbers(masked.vertices.clone().narrow(0, row, 1));
            assert_close("masked", &found, &expected.vertices, 2e-6);
        }
        // As in the authors' release: a body whose rest shape is the clothed one.
        let release = clothed.with_joints(JointSource::ClothedTemplate);
        let output = release.forward(inputs.input(&device)).unwrap();
        for row in 0..BATCH {
            let clothes = inputs.displacement.slice(s![row, .., ..]);
            let shape = model.rest_shape(&inputs.betas.row(row).to_vec()).unwrap() + clothes;
            let pose = inputs.pose.row(row).to_vec();
            let expected = model.pose_shape(&shape, &pose, inputs.transl(row), None).unwrap();
            let found = numbers(output.vertices.clone().narrow(0, row, 1));
            assert_close("release vertices", &found, &expected.vertices, 2e-6);
            let found = numbers(output.joints.clone().narrow(0, row, 1));
            assert_close("release joints", &found, &expected.joints, 2e-6);
        }
        assert!(bare_joints.is_ok());
        let without = SmplInput { displacement: None, ..inputs.input(&device) };
        let body = release.body().forward(without.clone()).unwrap();
        let same = release.forward(without).unwrap();
        assert_eq!(numbers(same.vertices), numbers(body.vertices));
    }
    assert!(ClothingMask::from_indices(3, &[0]).is_ok_and(|short| {
        let smpl = Smpl::new(&model, &devices()[0]).unwrap();
        ClothedSmpl::new(smpl).with_mask(&short).is_err()
    }));
}

#[test]
fn arguments_that_do_not_fit_are_named() {
    let (model, inputs) = (random_model(), inputs());
    let device = &devices()[0];
    let smpl = Smpl::new(&model, device).unwrap();
    let zeros = |shape: [usize; 2]| Tensor::<2>::zeros(shape, device);
    let clothes = |shape: [usize; 3]| Some(Tensor::<3>::zeros(shape, device));
    let good = || inputs.input(device);
    let cases = [
        (SmplInput { betas: zeros([4, 3]), ..good() }, "3 betas, but the body has 2"),
        (SmplInput { betas: zeros([3, 2]), ..good() }, "batch of 4"),
        (SmplInput { pose: Pose::AxisAngle(zeros([4, 11])), ..good() }, "pose: shape [4, 11]"),
        (SmplInput { transl: zeros([1, 3]), ..good() }, "transl: shape [1, 3]"),
        (SmplInput { displacement: clothes([4, 11, 3]), ..good() }, "displacement: shape"),
        (SmplInput { displacement: clothes([1, 12, 3]), ..good() }, "displacement"),
    ];
    for (input, expected) in cases {
        let message = smpl.forward(input.clone()).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
        let release =
            ClothedSmpl::new(smpl.clone()).with_joints(JointSource::ClothedTemplate).forward(input);
        assert!(release.is_err(), "{expected}");
    }
    let singular = {
        let mut model = random_model();
        model.weights.row_mut(5).assign(&ndarray::array![0.0, 0.5, 0.5, 0.0]);
        let mut pose = Array2::zeros((1, 12));
        pose[[0, 3]] = PI;
        let vertices = Tensor::<3>::zeros([1, 12, 3], device);
        let pose = Pose::AxisAngle(tensor(&pose, device));
        let smpl = Smpl::new(&model, device).unwrap();
        smpl.unpose(vertices, zeros([1, 2]), pose, zeros([1, 3])).unwrap_err().to_string()
    };
    assert!(singular.contains("vertex 5"), "{singular}");
}

#[test]
fn rodrigues_is_right_at_every_angle() {
    let axis = [0.6f64, -0.48, 0.64];
    let angles = [0.0, 1e-7, 1e-3, 0.3, 0.499, 0.501, 1.0, 3.0, PI, 2.0 * PI, 7.0];
    for device in devices().into_iter().map(Device::autodiff) {
        for angle in angles {
            let v = axis.map(|x| x * angle);
            let input = tensor::<2, _>(&Array2::from(vec![v]), &device).require_grad();
            let output = rodrigues(input.clone());
            let expected: Array1<f64> =
                crate::joints::rotation_matrix(v).as_flattened().to_vec().into();
            assert_close("rotation", &numbers(output.clone().inner()), &expected, 2e-6);
            // Gradient of a weighted sum compared with finite differences on the host.
            let weights: Array1<f64> = (0..9).map(|i| 1.0 + f64::from(i) * 0.7 % 2.0).collect();
            let mut state = Array1::from(v.to_vec());
            let expected = differences(
                &mut state,
                |v| v,
                |v| {
                    let r = crate::joints::rotation_matrix([v[0], v[1], v[2]]);
                    r.as_flattened().iter().zip(&weights).map(|(r, w)| r * w).sum()
                },
            );
            let weights = weights.into_shape_with_order((1, 3, 3)).unwrap();
            let grads = (output * tensor(&weights, &device)).sum().backward();
            let found = numbers(input.grad(&grads).unwrap());
            assert_close(&format!("gradient at {angle}"), &found, &expected, 2e-5);
        }
    }
}

#[test]
fn double_precision_unposes_exactly() {
    let (model, inputs) = (random_model(), inputs());
    for device in devices() {
        let smpl = Smpl::with_precision(&model, &device, FloatDType::F64).unwrap();
        let SmplInput { betas, pose, transl, displacement } = inputs.input(&device);
        let clothes = displacement.clone().unwrap().cast(FloatDType::F64);
        let posed = smpl
            .forward(SmplInput {
                betas: betas.clone(),
                pose: pose.clone(),
                transl: transl.clone(),
                displacement,
            })
            .unwrap();
        let canonical = smpl.unpose(posed.vertices, betas.clone(), pose, transl).unwrap();
        let lost = canonical - smpl.rest_shape(betas).unwrap() - clothes;
        let lost = lost.abs().max().into_scalar::<f64>();
        assert!(lost < 1e-12, "{lost:e}");
    }
}
