//! Convolutions with fused selection, constant terms, activation and normalisation.

use burn::tensor::{Device, Tensor, activation};
use cape_graph::{
    ConvGraph, Epilogue, GroupNorm, cheb_conv, cheb_features, group_norm_relu, norm_conv,
    sparse_matmul,
};
use proptest::prelude::*;
use sprs::{CsMat, TriMat};

use crate::{
    host,
    support::{
        assert_agree, assert_close, assert_host, assert_partial_tracking, devices, is_cpu, random,
        run, sparse,
    },
};

const EPSILON: f64 = 1e-3;

/// Selection of every second and every seventh vertex, in descending order.
pub(crate) fn selection(vertices: usize) -> CsMat<f64> {
    let mut kept: Vec<usize> = (0..vertices).filter(|v| v % 2 == 0 || v % 7 == 0).collect();
    kept.reverse();
    let mut matrix = TriMat::new((kept.len(), vertices));
    for (row, &vertex) in kept.iter().enumerate() {
        matrix.add_triplet(row, vertex, 1.0);
    }
    matrix.to_csr()
}

/// Extents and options of a tested convolution.
#[derive(Debug, Clone, Copy)]
struct Case {
    batch: usize,
    vertices: usize,
    input: usize,
    output: usize,
    order: usize,
    constant_terms: usize,
    slope: Option<f64>,
    pooled: bool,
}

struct Graphs {
    laplacian: CsMat<f64>,
    down: Option<CsMat<f64>>,
    graph: ConvGraph,
    whole: ConvGraph,
    selection: Option<cape_graph::SparseMatrix>,
}

impl Case {
    fn graphs(&self, device: &Device) -> Graphs {
        let laplacian = sparse(51, self.vertices, self.vertices, 5, false);
        let down = self.pooled.then(|| selection(self.vertices));
        Graphs {
            graph: ConvGraph::new(&laplacian, down.as_ref(), device),
            whole: ConvGraph::new(&laplacian, None, device),
            selection: down.as_ref().map(|down| cape_graph::SparseMatrix::new(down, device)),
            laplacian,
            down,
        }
    }

    /// Features, weights, constant terms.
    fn inputs(&self) -> Vec<Vec<f64>> {
        let mut inputs = vec![
            random(52, self.batch * self.vertices * self.input),
            random(53, self.input * self.order * self.output),
        ];
        if self.constant_terms > 0 {
            inputs.push(random(54, self.batch * self.constant_terms * self.output));
        }
        inputs
    }

    fn shaped(&self, x: &[Tensor<1>]) -> (Tensor<3>, Tensor<2>, Option<Tensor<3>>) {
        (
            x[0].clone().reshape([self.batch, self.vertices, self.input]),
            x[1].clone().reshape([self.input * self.order, self.output]),
            x.get(2).map(|constant_terms| {
                constant_terms.clone().reshape([self.batch, self.constant_terms, self.output])
            }),
        )
    }

    fn fused(&self, x: &[Tensor<1>], graphs: &Graphs) -> Tensor<3> {
        let (x, weight, constant_terms) = self.shaped(x);
        cheb_conv(
            x,
            weight,
            &graphs.graph,
            self.order,
            Epilogue { constant_terms, slope: self.slope },
        )
    }

    /// The same composed of separate operations on all vertices.
    fn composed(&self, x: &[Tensor<1>], graphs: &Graphs) -> Tensor<3> {
        let (x, weight, constant_terms) = self.shaped(x);
        let laplacian = graphs.whole.laplacian();
        let ones = Tensor::ones([self.batch, self.vertices, 1], &x.device());
        let flat: Tensor<2> = cheb_features(x, &laplacian, self.order).flatten(0, 1);
        let mut y = flat.matmul(weight).reshape([self.batch, self.vertices, self.output]);
        if let Some(constant_terms) = constant_terms {
            y = y + cheb_features(ones, &laplacian, self.constant_terms).matmul(constant_terms);
        }
        if let Some(slope) = self.slope {
            y = activation::leaky_relu(y, slope);
        }
        match &graphs.selection {
            Some(selection) => sparse_matmul(y, selection),
            None => y,
        }
    }

    fn check(&self, name: &str, device: &Device) {
        let (graphs, inputs) = (self.graphs(device), self.inputs());
        let tracked = vec![true; inputs.len()];
        let fused = run(device, &inputs, &tracked, &|x| self.fused(x, &graphs));
        let composed = run(device, &inputs, &tracked, &|x| self.composed(x, &graphs));
        assert_agree(&format!("{name}: {self:?}"), &fused, &composed, 1e-5);
    }
}

fn case(batch: usize, vertices: usize, input: usize, output: usize, order: usize) -> Case {
    Case { batch, vertices, input, output, order, constant_terms: 0, slope: None, pooled: false }
}

#[test]
fn fused_convolution_agrees_with_its_parts() {
    // Blocks of 96 and of 128 vertices, tiles of 4 to 8 by 4 to 32, depths of 512; batches below 8
    // are split inside examples.
    for (name, device) in devices() {
        for case in [
            case(1, 1, 1, 1, 1),
            case(2, 13, 3, 2, 2),
            case(3, 97, 7, 16, 3),
            case(9, 31, 5, 33, 4),
            case(11, 21, 16, 7, 5),
            case(1, 1027, 6, 5, 2),
            case(17, 130, 3, 64, 3),
            case(2, 389, 48, 50, 2),
            case(8, 65, 49, 17, 3),
            case(1, 29, 600, 40, 2),
            case(3, 35, 40, 3, 2),
        ] {
            if case.input.max(case.output).max(case.vertices) > 130 && !is_cpu(&name) {
                continue;
            }
            for pooled in [false, true] {
                for constant_terms in [0, 1, case.order] {
                    for slope in [None, Some(0.2)] {
                        Case { constant_terms, slope, pooled, ..case }.check(&name, &device);
                    }
                }
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn convolution_of_any_size_agrees_with_its_parts(
        (batch, vertices, input, output) in (1usize..20, 1usize..150, 1usize..40, 1usize..70),
        (order, pooled, slope, constant_terms) in (1usize..5, any::<bool>(), any::<bool>(), 0usize..3),
    ) {
        let (name, device) = devices().swap_remove(0);
        prop_assume!(is_cpu(&name) || batch * vertices * input * output < 100_000);
        let constant_terms = [0, 1, order][constant_terms];
        let slope = slope.then_some(0.2);
        Case { constant_terms, slope, pooled, ..case(batch, vertices, input, output, order) }
            .check(&name, &device);
    }

    #[test]
    fn normalised_convolution_of_any_size_agrees_with_its_parts(
        (batch, vertices, width, groups) in (1usize..20, 2usize..150, 1usize..6, 1usize..9),
        (output, order, constant) in (1usize..70, 1usize..4, 0usize..8),
        (pooled, add) in (any::<bool>(), any::<bool>()),
    ) {
        let (name, device) = devices().swap_remove(0);
        prop_assume!(is_cpu(&name) || batch * vertices * width * groups * output < 100_000);
        let channels = width * groups;
        // A group of constants alone has no variance: see below.
        let constant = if order == 1 { constant.min(width - 1) } else { 0 };
        let conv = Case { pooled, ..case(batch, vertices, channels - constant, output, order) };
        NormCase { conv, groups, constant, add }.check(&name, &device);
    }
}

#[test]
fn fused_convolution_agrees_with_finite_differences() {
    for (name, device) in devices() {
        for order in 1..=4 {
            for (batch, vertices, input, output) in [(1, 5, 2, 3), (3, 4, 1, 2), (11, 3, 2, 1)] {
                for constant_terms in [1, order] {
                    let slope = Some(0.2);
                    let case = case(batch, vertices, input, output, order);
                    let case = Case { constant_terms, slope, pooled: true, ..case };
                    let (graphs, inputs) = (case.graphs(&device), case.inputs());
                    let outcome = run(&device, &inputs, &[true; 3], &|x| case.fused(x, &graphs));
                    assert_host(&format!("{name}: {case:?}"), &outcome, &inputs, &|x| {
                        host_conv(&case, &graphs, x)
                    });
                }
            }
        }
    }
}

fn host_conv(case: &Case, graphs: &Graphs, x: &[Vec<f64>]) -> Vec<f64> {
    let Case { batch, vertices, input, output, order, constant_terms, .. } = *case;
    let mut y = host::cheb_conv(&x[0], &x[1], &graphs.laplacian, input, order);
    let basis = host::cheb_features(&vec![1.0; vertices], &graphs.laplacian, 1, constant_terms);
    for (i, y) in y.iter_mut().enumerate() {
        let (example, v, o) = (i / (vertices * output), i / output % vertices, i % output);
        for r in 0..constant_terms {
            *y += basis[v * constant_terms + r] * x[2][(example * constant_terms + r) * output + o];
        }
    }
    let y = host::bias_leaky_relu(&y, &[0.0], case.slope.unwrap_or(1.0));
    assert_eq!(y.len(), batch * vertices * output);
    graphs.down.as_ref().map_or(y.clone(), |down| host::sparse_matmul(&y, down, output))
}

/// Extents and options of a tested normalised convolution.
#[derive(Debug, Clone, Copy)]
struct NormCase {
    conv: Case,
    groups: usize,
    constant: usize,
    add: bool,
}

impl NormCase {
    /// Features, weights, scale, shift, constant channels, base.
    fn inputs(&self, graphs: &Graphs) -> Vec<Vec<f64>> {
        let Case { batch, vertices, input, output, order, .. } = self.conv;
        let channels = input + self.constant;
        let mut x = random(61, batch * vertices * input);
        x.iter_mut().enumerate().for_each(|(i, x)| *x += (i % input % 3) as f64 * 0.5);
        vec![
            x,
            random(62, channels * order * output),
            random(63, channels),
            random(64, channels),
            random(65, batch * self.constant.max(1)),
            random(66, batch * graphs.graph.kept() * output),
        ]
    }

    fn parts(&self, x: &[Tensor<1>], graphs: &Graphs) -> Parts {
        let Case { batch, vertices, input, output, order, .. } = self.conv;
        let channels = input + self.constant;
        Parts {
            x: x[0].clone().reshape([batch, vertices, input]),
            weight: x[1].clone().reshape([channels * order, output]),
            norm: GroupNorm {
                gamma: x[2].clone(),
                beta: x[3].clone(),
                groups: self.groups,
                epsilon: EPSILON,
            },
            constant: (self.constant > 0).then(|| x[4].clone().reshape([batch, self.constant])),
            base: self.add.then(|| x[5].clone().reshape([batch, graphs.graph.kept(), output])),
        }
    }

    fn fused(&self, x: &[Tensor<1>], graphs: &Graphs) -> Tensor<3> {
        let Parts { x, weight, norm, constant, base } = self.parts(x, graphs);
        norm_conv(x, constant, norm, weight, &graphs.graph, self.conv.order, base)
    }

    fn composed(&self, x: &[Tensor<1>], graphs: &Graphs) -> Tensor<3> {
        let Parts { mut x, weight, norm, constant, base } = self.parts(x, graphs);
        if let Some(constant) = constant {
            let [batch, vertices, _] = x.dims();
            let tiled = constant.reshape([batch, 1, self.constant]);
            x = Tensor::cat(vec![x, tiled.expand([batch, vertices, self.constant])], 2);
        }
        let x = group_norm_relu(x, norm);
        let y = cheb_conv(x, weight, &graphs.graph, self.conv.order, Epilogue::default());
        match base {
            Some(base) => base + y,
            None => y,
        }
    }

    fn check(&self, name: &str, device: &Device) {
        let graphs = self.conv.graphs(device);
        let inputs = self.inputs(&graphs);
        let fused = run(device, &inputs, &[true; 6], &|x| self.fused(x, &graphs));
        let composed = run(device, &inputs, &[true; 6], &|x| self.composed(x, &graphs));
        assert_agree(&format!("{name}: {self:?}"), &fused, &composed, 2e-5);
    }
}

struct Parts {
    x: Tensor<3>,
    weight: Tensor<2>,
    norm: GroupNorm,
    constant: Option<Tensor<2>>,
    base: Option<Tensor<3>>,
}

#[test]
fn normalised_convolution_agrees_with_its_parts() {
    for (name, device) in devices() {
        for (conv, groups, constant) in [
            (case(1, 3, 2, 1, 1), 1, 0),
            (case(2, 97, 5, 16, 1), 2, 3),
            (case(9, 65, 27, 33, 1), 4, 5),
            (case(1, 1027, 17, 5, 1), 4, 3),
            (case(17, 33, 64, 64, 1), 8, 8),
            (case(3, 130, 12, 20, 2), 3, 0),
            (case(8, 49, 16, 17, 3), 16, 0),
            (case(1, 29, 528, 40, 1), 32, 16),
        ] {
            if conv.input.max(conv.output).max(conv.vertices) > 130 && !is_cpu(&name) {
                continue;
            }
            for pooled in [false, true] {
                for add in [false, true] {
                    let conv = Case { pooled, ..conv };
                    NormCase { conv, groups, constant, add }.check(&name, &device);
                }
            }
        }
    }
}

#[test]
fn constants_alone_in_a_group_are_their_shift() {
    // Separate operations divide rounding errors by the root of epsilon there.
    for (name, device) in devices() {
        let case = NormCase { conv: case(2, 9, 2, 3, 1), groups: 4, constant: 2, add: false };
        let graphs = case.conv.graphs(&device);
        let inputs = case.inputs(&graphs);
        let outcome = run(&device, &inputs, &[true; 6], &|x| case.fused(x, &graphs));
        let expected = run(&device, &inputs, &[true; 6], &|x| {
            let Parts { x: features, weight, mut norm, .. } = case.parts(x, &graphs);
            let beta = norm.beta.clone().slice(2..4);
            norm.gamma = norm.gamma.slice(0..2);
            norm.beta = norm.beta.slice(0..2);
            norm.groups = 2;
            let shift =
                activation::relu(beta).reshape([1, 2]).matmul(weight.clone().slice([2..4, 0..3]));
            let weight = weight.slice([0..2, 0..3]);
            norm_conv(features, None, norm, weight, &graphs.graph, 1, None)
                + shift.reshape([1, 1, 3])
        });
        let close = |actual: &[f32], expected: &[f32]| {
            let expected: Vec<f64> = expected.iter().map(|&x| f64::from(x)).collect();
            assert_close(&name, actual, &expected, 1e-5);
        };
        close(&outcome.output, &expected.output);
        // All but the gradient of the scale of the constant channels, which consists of rounding errors.
        for i in [0, 1, 3] {
            close(outcome.gradients[i].as_ref().unwrap(), expected.gradients[i].as_ref().unwrap());
        }
        let constants = outcome.gradients[4].as_ref().unwrap();
        assert!(constants.iter().all(|g| g.abs() < 1e-3), "{name}: {constants:?}");
    }
}

#[test]
fn normalised_convolution_agrees_with_finite_differences() {
    for (name, device) in devices() {
        for (batch, vertices, input, constant) in [(1, 5, 2, 2), (3, 4, 3, 1), (11, 3, 1, 1)] {
            let conv = case(batch, vertices, input, 2, 1);
            let case = NormCase { conv, groups: 1, constant, add: true };
            let graphs = conv.graphs(&device);
            let inputs = case.inputs(&graphs);
            let outcome = run(&device, &inputs, &[true; 6], &|x| case.fused(x, &graphs));
            assert_host(&format!("{name}: {case:?}"), &outcome, &inputs, &|x| {
                let all: Vec<f64> = x[0]
                    .chunks(input)
                    .enumerate()
                    .flat_map(|(i, features)| {
                        let constants = &x[4][i / vertices * constant..][..constant];
                        features.iter().chain(constants).copied().collect::<Vec<_>>()
                    })
                    .collect();
                let active = host::group_norm_relu(&all, &x[2], &x[3], vertices, 1, EPSILON);
                let channels = input + constant;
                let y = host::cheb_conv(&active, &x[1], &graphs.laplacian, channels, 1);
                y.iter().zip(&x[5]).map(|(y, base)| y + base).collect()
            });
        }
    }
}

#[test]
fn fused_operations_give_only_the_gradients_asked_for() {
    for (name, device) in devices() {
        for batch in [2, 11] {
            let conv = Case {
                constant_terms: 1,
                slope: Some(0.2),
                pooled: true,
                ..case(batch, 9, 3, 2, 2)
            };
            let graphs = conv.graphs(&device);
            assert_partial_tracking(&name, &device, &conv.inputs(), &|x| conv.fused(x, &graphs));
            let conv = case(batch, 9, 3, 2, 1);
            let norm = NormCase { conv, groups: 2, constant: 1, add: true };
            let graphs = conv.graphs(&device);
            let inputs = norm.inputs(&graphs);
            assert_partial_tracking(&name, &device, &inputs, &|x| norm.fused(x, &graphs));
        }
    }
}

#[test]
fn a_base_that_is_still_needed_is_left_alone() {
    for (name, device) in devices() {
        let conv = case(2, 9, 3, 2, 1);
        let case = NormCase { conv, groups: 3, constant: 0, add: true };
        let graphs = conv.graphs(&device);
        let inputs = case.inputs(&graphs);
        let outcome = run(&device, &inputs, &[true; 6], &|x| {
            let Parts { x, weight, norm, base, .. } = case.parts(x, &graphs);
            let base = base.unwrap();
            let y = norm_conv(x, None, norm, weight, &graphs.graph, 1, Some(base.clone()));
            y - base
        });
        let without = NormCase { add: false, ..case };
        let expected = run(&device, &inputs, &[true; 6], &|x| without.fused(x, &graphs));
        assert_close(
            &name,
            &outcome.output,
            &expected.output.iter().map(|&x| f64::from(x)).collect::<Vec<_>>(),
            1e-5,
        );
    }
}
