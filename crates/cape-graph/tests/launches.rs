//! Kernel launches of operations on the devices of `CAPE_TEST_DEVICES`; one test, as launches of all
//! threads are counted.

use burn::tensor::{Device, Tensor};
use cape_graph::{
    ConvGraph, Epilogue, KernelLaunches, MomentumStep, cheb_conv, momentum_step,
    sparse_from_triplets,
};

#[test]
fn operations_take_few_launches() {
    let names = std::env::var("CAPE_TEST_DEVICES").unwrap_or_else(|_| cape_core::DEVICES[0].into());
    for name in names.split(',') {
        let device = cape_core::parse_device(name).unwrap();
        let kernels = |expected: usize| if cape_core::is_cpu(&device) { 0 } else { expected };
        let launches = launches_of_a_step(&device);
        assert_eq!(launches.total(), kernels(1), "{name}: {launches:?}");
        // Basis, product and epilogue.
        let launches = launches_of_a_convolution(&device);
        assert_eq!(launches.total(), kernels(3), "{name}: {launches:?}");
    }
}

fn launches_of_a_step(device: &Device) -> KernelLaunches {
    let [x, g, v] = [3.0, 2.0, 1.0].map(|value| Tensor::<1>::full([300], value, device));
    let step = MomentumStep { scale: 1.0, momentum: 0.5, rate: 0.5 };
    let (value, launches) =
        KernelLaunches::during(|| momentum_step(x, g, v, step).0.into_data().try_into_vec::<f32>());
    assert_eq!(value.unwrap(), [1.75; 300]);
    launches
}

fn launches_of_a_convolution(device: &Device) -> KernelLaunches {
    let path = sparse_from_triplets("L", (2, 2), &[0, 1], &[1, 0], &[-1.0; 2]).unwrap();
    let graph = ConvGraph::new(&path, None, device);
    let x = Tensor::<3>::from_floats([[[3.0], [7.0]]], device);
    let weight = Tensor::<2>::from_floats([[2.0], [1.0]], device);
    let constant_terms = Some(Tensor::zeros([1, 1, 1], device));
    let epilogue = Epilogue { constant_terms, slope: Some(0.5) };
    let work = || cheb_conv(x, weight, &graph, 2, epilogue).into_data().try_into_vec::<f32>();
    let (y, launches) = KernelLaunches::during(work);
    // 2 x − (the other x), and half of it where it is negative.
    assert_eq!(y.unwrap(), [-0.5, 11.0]);
    launches
}
