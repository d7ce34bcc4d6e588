//! Fused forward pass compared with tensor operations and with the host, for random sizes.

use burn::tensor::{Device, Distribution, FloatDType, Tensor, TensorData};
use ndarray::{Array2, Array3, ArrayRef, Dimension, s};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

use super::{test_model::random, *};
use crate::devices;

/// Tolerance for bodies of about a metre, metres.
const METRES: f64 = 5e-6;

#[derive(Debug, Clone, Copy)]
struct Sizes {
    batch: usize,
    vertices: usize,
    joints: usize,
    betas: usize,
    /// Number of nonzero blend weights of a vertex.
    bones: usize,
}

fn sizes() -> impl Strategy<Value = Sizes> {
    let batch = prop_oneof![1usize..8, 44usize..60];
    (batch, 1usize..300, 2usize..9, 1usize..5, 1usize..9).prop_map(
        |(batch, vertices, joints, betas, bones)| Sizes {
            batch,
            vertices,
            joints,
            betas,
            bones: bones.min(joints),
        },
    )
}

fn rows(shape: (usize, usize), bones: usize, rng: &mut ChaCha8Rng) -> Array2<f64> {
    let mut array = Array2::zeros(shape);
    for mut row in array.rows_mut() {
        for _ in 0..bones {
            row[rng.random_range(0..shape.1)] = rng.random_range(0.1..1.0);
        }
        let sum = row.sum();
        row /= sum;
    }
    array
}

fn body(sizes: Sizes, rng: &mut ChaCha8Rng) -> SmplModel {
    let Sizes { vertices: v, joints: j, betas, bones, .. } = sizes;
    SmplModel {
        v_template: random((v, 3), 1.0, rng),
        shapedirs: random((v, 3, betas), 0.1, rng),
        posedirs: random((v, 3, 9 * (j - 1)), 0.05, rng),
        joint_regressor: rows((j, v), 5, rng),
        weights: rows((v, j), bones, rng),
        parents: (0..j).map(|joint| (joint > 0).then(|| rng.random_range(0..joint))).collect(),
        faces: Vec::new(),
    }
}

struct Inputs {
    betas: Array2<f64>,
    pose: Array2<f64>,
    transl: Array2<f64>,
    displacement: Option<Array3<f64>>,
}

impl Inputs {
    /// Random inputs that are exact in `f32`; some joints are not rotated.
    fn new(sizes: Sizes, clothed: bool, rng: &mut ChaCha8Rng) -> Self {
        let Sizes { batch: n, vertices, joints, betas, .. } = sizes;
        let mut pose: Array2<f64> = random((n, 3 * joints), 1.0, rng);
        let resting = rng.random_range(0..joints);
        pose.slice_mut(s![.., 3 * resting..3 * resting + 3]).fill(0.0);
        let used = rng.random_range(1..=betas);
        let round = |x: f64| f64::from(x as f32);
        Self {
            betas: random((n, used), 1.0, rng).mapv(round),
            pose: pose.mapv(round),
            transl: random((n, 3), 2.0, rng).mapv(round),
            displacement: clothed.then(|| random((n, vertices, 3), 0.05, rng).mapv(round)),
        }
    }

    fn input(&self, device: &Device) -> SmplInput {
        SmplInput {
            betas: tensor(&self.betas, device),
            pose: Pose::AxisAngle(tensor(&self.pose, device)),
            transl: tensor(&self.transl, device),
            displacement: self.displacement.as_ref().map(|clothes| tensor(clothes, device)),
        }
    }

    fn body(&self, range: std::ops::Range<usize>) -> Self {
        Self {
            betas: self.betas.slice(s![range.clone(), ..]).to_owned(),
            pose: self.pose.slice(s![range.clone(), ..]).to_owned(),
            transl: self.transl.slice(s![range.clone(), ..]).to_owned(),
            displacement: self.displacement.as_ref().map(|d| d.slice(s![range, .., ..]).to_owned()),
        }
    }
}

fn tensor<const D: usize, N: Dimension>(array: &ArrayRef<f64, N>, device: &Device) -> Tensor<D> {
    let values: Vec<f32> = array.iter().map(|&value| value as f32).collect();
    let shape: [usize; D] = array.shape().try_into().unwrap();
    Tensor::from_data(TensorData::new(values, shape), device)
}

fn numbers<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.try_into_vec_as::<f32>().unwrap()
}

fn distance<const D: usize>(found: Tensor<D>, expected: Tensor<D>) -> f64 {
    (found - expected).abs().max().into_scalar::<f64>()
}

fn on_threads<R: Send>(threads: usize, work: impl FnOnce() -> R + Send) -> R {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(work)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn one_pass_agrees_with_tensors_and_the_host(sizes in sizes(), clothed: bool, seed: u64) {
        let rng = &mut ChaCha8Rng::seed_from_u64(seed);
        let model = body(sizes, rng);
        let inputs = Inputs::new(sizes, clothed, rng);
        for device in devices() {
            let smpl = Smpl::new(&model, &device).unwrap();
            prop_assert!(smpl.cpu.is_some());
            let input = inputs.input(&device);
            let found = smpl.forward(input.clone()).unwrap();
            let composed = smpl.forward_composed(input.clone(), None).unwrap();
            prop_assert!(distance(found.vertices.clone(), composed.vertices) < METRES);
            prop_assert!(distance(found.joints.clone(), composed.joints) < METRES);

            let by_matrices =
                SmplInput { pose: Pose::Rotations(smpl.rotations(input.pose.clone()).unwrap()), ..input };
            let by_matrices = smpl.forward(by_matrices).unwrap();
            prop_assert!(distance(found.vertices.clone(), by_matrices.vertices) < METRES);

            let (vertices, joints) = (numbers(found.vertices), numbers(found.joints));
            let (v, j) = (3 * sizes.vertices, 3 * sizes.joints);
            for row in 0..sizes.batch {
                let list = |array: &Array2<f64>| array.row(row).to_vec();
                let transl: [f64; 3] = list(&inputs.transl).try_into().unwrap();
                let clothes =
                    inputs.displacement.as_ref().map(|d| d.slice(s![row, .., ..]).to_owned());
                let expected = model
                    .pose(&list(&inputs.betas), &list(&inputs.pose), transl, clothes.as_ref())
                    .unwrap();
                let off = |found: &[f32], expected: &Array2<f64>| {
                    let pairs = found.iter().zip(expected);
                    pairs.fold(0.0f64, |most, (&f, e)| most.max((f64::from(f) - e).abs()))
                };
                prop_assert!(off(&vertices[row * v..][..v], &expected.vertices) < METRES);
                prop_assert!(off(&joints[row * j..][..j], &expected.joints) < METRES);
            }
        }
    }

    #[test]
    fn neither_threads_nor_the_batch_show(sizes in sizes(), clothed: bool, seed: u64) {
        let rng = &mut ChaCha8Rng::seed_from_u64(seed);
        let model = body(sizes, rng);
        let inputs = Inputs::new(sizes, clothed, rng);
        let device = &devices()[0];
        let smpl = Smpl::new(&model, device).unwrap();
        let pose = |inputs: &Inputs, threads| {
            let output = on_threads(threads, || smpl.forward(inputs.input(device)).unwrap());
            (numbers(output.vertices), numbers(output.joints))
        };
        let one = pose(&inputs, 1);
        prop_assert_eq!(&one, &pose(&inputs, 3));
        let row = rng.random_range(0..sizes.batch);
        let alone = pose(&inputs.body(row..row + 1), 2);
        let (v, j) = (3 * sizes.vertices, 3 * sizes.joints);
        prop_assert_eq!(&alone.0[..], &one.0[row * v..][..v]);
        prop_assert_eq!(&alone.1[..], &one.1[row * j..][..j]);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn gradients_of_one_pass_are_those_of_autodiff(sizes in sizes(), clothed: bool, seed: u64) {
        let rng = &mut ChaCha8Rng::seed_from_u64(seed);
        let model = body(sizes, rng);
        let inputs = Inputs::new(sizes, clothed, rng);
        let mut points = |count| random((sizes.batch, count, 3), 1.0, rng);
        let (by_vertex, by_joint) = (points(sizes.vertices), points(sizes.joints));
        for device in devices() {
            let tracked = device.clone().autodiff();
            let double = Smpl::with_precision(&model, &tracked, FloatDType::F64).unwrap();
            let input = inputs.input(&tracked);
            let Pose::AxisAngle(pose) = input.pose else { unreachable!() };
            let given = [input.betas, pose, input.transl].map(Tensor::require_grad);
            let clothes = input.displacement.map(Tensor::require_grad);
            let [betas, pose, transl] = given.clone();
            let output = double
                .forward(SmplInput {
                    betas,
                    pose: Pose::AxisAngle(pose),
                    transl,
                    displacement: clothes.clone(),
                })
                .unwrap();
            let weighted = |found: Tensor<3>, by: &Array3<f64>| {
                (found * tensor::<3, _>(by, &tracked).cast(FloatDType::F64)).sum()
            };
            let sum = weighted(output.vertices, &by_vertex) + weighted(output.joints, &by_joint);
            let gradients = sum.backward();
            let expected = given.map(|it| numbers(it.grad(&gradients).unwrap()));

            let smpl = Smpl::new(&model, &device).unwrap();
            let gradient = || SmplOutput {
                vertices: tensor(&by_vertex, &device),
                joints: tensor(&by_joint, &device),
            };
            let pull = |threads| {
                on_threads(threads, || smpl.pull_back(inputs.input(&device), gradient()).unwrap())
            };
            let found = pull(2);
            let displacement = found.displacement.map(numbers);
            prop_assert_eq!(&pull(1).displacement.map(numbers), &displacement);
            prop_assert_eq!(displacement.is_some(), clothes.is_some());
            let found = [found.betas, found.pose, found.transl].map(numbers);
            prop_assert_eq!(&found[1], &numbers(pull(3).pose));
            let clothes = clothes.map(|it| numbers(it.grad(&gradients).unwrap()));
            let expected = expected.into_iter().chain(clothes);
            for (found, expected) in found.into_iter().chain(displacement).zip(expected) {
                let most = expected.iter().fold(0.0f32, |most, x| most.max(x.abs()));
                for (found, expected) in found.iter().zip(&expected) {
                    prop_assert!((found - expected).abs() <= 2e-5 * most, "{found} {expected}");
                }
            }
        }
    }
}

#[test]
fn gradients_need_the_fused_pass_and_axis_angles() {
    let rng = &mut ChaCha8Rng::seed_from_u64(1);
    let sizes = Sizes { batch: 2, vertices: 20, joints: 3, betas: 2, bones: 2 };
    let (model, inputs) = (body(sizes, rng), Inputs::new(sizes, true, rng));
    for device in devices() {
        let gradient = |points: [usize; 2]| SmplOutput {
            vertices: Tensor::ones([2, points[0], 3], &device),
            joints: Tensor::ones([2, points[1], 3], &device),
        };
        let message = |smpl: &Smpl, input, points| {
            smpl.pull_back(input, gradient(points)).unwrap_err().to_string()
        };
        let smpl = Smpl::new(&model, &device).unwrap();
        let shape = message(&smpl, inputs.input(&device), [19, 3]);
        assert!(shape.contains("gradient of vertices: shape [2, 19, 3]"), "{shape}");
        let rotations = smpl.rotations(inputs.input(&device).pose).unwrap();
        let input = SmplInput { pose: Pose::Rotations(rotations), ..inputs.input(&device) };
        assert!(message(&smpl, input, [20, 3]).contains("axis-angle"));
        let double = Smpl::with_precision(&model, &device, FloatDType::F64).unwrap();
        assert!(message(&double, inputs.input(&device), [20, 3]).contains("f32"));
    }
}

#[test]
fn tensors_are_used_wherever_gradients_may_be_asked_for() {
    let rng = &mut ChaCha8Rng::seed_from_u64(1);
    let sizes = Sizes { batch: 2, vertices: 20, joints: 3, betas: 2, bones: 2 };
    let (model, inputs) = (body(sizes, rng), Inputs::new(sizes, true, rng));
    for device in devices() {
        let tracked = device.clone().autodiff();
        let smpl = Smpl::new(&model, &tracked).unwrap();
        assert!(smpl.cpu.is_none());
        let betas = tensor::<2, _>(&inputs.betas, &tracked).require_grad();
        let input = SmplInput { betas: betas.clone(), ..inputs.input(&tracked) };
        let output = smpl.forward(input).unwrap();
        let plain = Smpl::new(&model, &device).unwrap().forward(inputs.input(&device)).unwrap();
        assert!(distance(output.vertices.clone().inner(), plain.vertices) < METRES);
        let grads = output.vertices.sum().backward();
        assert!(betas.grad(&grads).is_some());
    }
}

#[test]
fn inputs_are_read_whatever_their_layout() {
    let rng = &mut ChaCha8Rng::seed_from_u64(2);
    let sizes = Sizes { batch: 3, vertices: 40, joints: 4, betas: 2, bones: 4 };
    let model = body(sizes, rng);
    for device in devices() {
        let smpl = Smpl::new(&model, &device).unwrap();
        let normal = Distribution::Normal(0.0, 0.3);
        let input = SmplInput {
            betas: Tensor::random([2, 3], normal, &device).swap_dims(0, 1),
            pose: Pose::AxisAngle(Tensor::random([5, 12], normal, &device).narrow(0, 1, 3)),
            transl: Tensor::random([3, 6], normal, &device).narrow(1, 2, 3),
            displacement: Some(Tensor::random([3, 3, 40], normal, &device).swap_dims(1, 2)),
        };
        let found = smpl.forward(input.clone()).unwrap();
        let expected = smpl.forward_composed(input, None).unwrap();
        assert!(distance(found.vertices, expected.vertices) < METRES);
        assert!(distance(found.joints, expected.joints) < METRES);
    }
}
