use nalgebra::DMatrix;
use ndarray::s;
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

use super::*;
use cape_core::silent;

/// Random rows with exponentially decreasing variances.
fn data(count: usize, numbers: usize, decay: f64) -> Array2<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut random = |shape| Array2::from_shape_simple_fn(shape, || rng.random_range(-1.0..1.0));
    let (scores, directions) = (random((count, numbers)), random((numbers, numbers)));
    let scale = Array1::from_iter((0..numbers).map(|k| (-decay * k as f64).exp()));
    (scores * &scale).dot(&directions) + 0.5
}

fn fit(data: &Array2<f64>, components: usize) -> Result<Pca> {
    let options = PcaOptions { components, ..PcaOptions::default() };
    let row = |index: usize| Ok(data.row(index).to_vec());
    Pca::fit(data.nrows(), data.ncols(), &options, &row, &mut silent)
}

/// Variances and projector of the leading components by a singular value decomposition.
fn by_svd(data: &Array2<f64>, components: usize) -> (Vec<f64>, Array2<f64>) {
    let mean = data.mean_axis(Axis(0)).unwrap();
    let centred = data - &mean;
    let matrix = DMatrix::from_row_iterator(data.nrows(), data.ncols(), centred.iter().copied());
    let svd = matrix.svd(false, true);
    let vt = svd.v_t.unwrap();
    let mut order: Vec<usize> = (0..svd.singular_values.len()).collect();
    order.sort_by(|&a, &b| svd.singular_values[b].total_cmp(&svd.singular_values[a]));
    order.truncate(components);
    let variance = |k: &usize| svd.singular_values[*k].powi(2) / data.nrows() as f64;
    let rows = Array2::from_shape_fn((components, data.ncols()), |(k, j)| vt[(order[k], j)]);
    (order.iter().map(variance).collect(), rows.t().dot(&rows))
}

#[test]
fn agrees_with_a_plain_decomposition() {
    for (count, numbers, decay, components) in [
        (300, 60, 0.2, 18),
        (50, 90, 0.02, 18),
        (40, 12, 0.5, 12),
        (9, 30, 0.1, 8),
        (500, 40, 0.0, 5),
    ] {
        let data = data(count, numbers, decay);
        let pca = fit(&data, components).unwrap();
        let (variances, projector) = by_svd(&data, components);
        for (found, expected) in pca.variances.iter().zip(&variances) {
            assert!((found - expected).abs() < 1e-8 * variances[0], "{found} {expected}");
        }
        let found = pca.components.t().dot(&pca.components);
        let off = (&found - &projector).iter().map(|x| x.abs()).fold(0.0, f64::max);
        assert!(off < 1e-5, "{count} x {numbers}: projector off by {off:e}");
        let gram = pca.components.dot(&pca.components.t());
        assert!((gram - Array2::<f64>::eye(components)).iter().all(|x| x.abs() < 1e-10));
        assert!(pca.residual <= 1e-9);
    }
}

/// The mean squared residual is the unexplained variance.
#[test]
fn reconstruction_leaves_the_unexplained_variance() {
    let data = data(200, 50, 0.1);
    let pca = fit(&data, 18).unwrap();
    let codes = pca.encode(data.view()).unwrap();
    assert_eq!(codes.dim(), (200, 18));
    let left = &data - &pca.decode(codes.view()).unwrap();
    let mean_square = (&left * &left).sum() / 200.0;
    let expected = pca.total_variance * (1.0 - pca.explained());
    assert!((mean_square - expected).abs() < 1e-9 * pca.total_variance);
    let again = pca.encode(pca.decode(codes.view()).unwrap().view()).unwrap();
    assert!((again - &codes).iter().all(|x| x.abs() < 1e-9));
}

#[test]
fn data_of_low_rank_converge_early() {
    let mut data = data(100, 40, 0.0);
    for k in 3..40 {
        let copy = data.column(k % 3).to_owned();
        data.column_mut(k).assign(&copy);
    }
    let pca = fit(&data, 10).unwrap();
    assert!(pca.variances.slice(s![3..]).iter().all(|v| *v < 1e-12 * pca.variances[0]));
    assert!((pca.explained() - 1.0).abs() < 1e-9);
    let same = Array2::from_elem((10, 6), 2.0);
    let pca = fit(&same, 2).unwrap();
    assert_eq!((pca.total_variance, pca.explained()), (0.0, 1.0));
}

#[test]
fn any_number_of_threads_gives_the_same_bits_and_files_keep_them() {
    let data = data(700, 30, 0.1);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| fit(&data, 6)).unwrap()
    };
    let pca = with(1);
    assert_eq!(pca, with(3));
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("pca.npz");
    pca.save(&path).unwrap();
    assert_eq!(Pca::load(&path).unwrap(), pca);
    let broken = Pca { mean: Array1::from_elem(30, f64::NAN), ..pca.clone() };
    broken.save(&path).unwrap();
    assert!(Pca::load(&path).unwrap_err().to_string().contains("`mean`: has a number"));
    let broken = Pca { mean: Array1::zeros(29), ..pca };
    broken.save(&path).unwrap();
    assert!(Pca::load(&path).unwrap_err().to_string().contains("`mean`: shape [29]"));
}

#[test]
fn invalid_fits_are_errors() {
    let data = data(10, 20, 0.1);
    let message = fit(&data, 10).unwrap_err().to_string();
    assert!(message.contains("10 principal components of 10 frames: expected 1 to 9"), "{message}");
    assert!(fit(&data, 0).is_err());
    let options = PcaOptions { components: 3, passes: 1, ..PcaOptions::default() };
    let row = |index: usize| Ok(data.row(index).to_vec());
    let message = Pca::fit(10, 20, &options, &row, &mut silent).unwrap_err().to_string();
    assert!(message.contains("after 1 passes"), "{message}");
    let row = |_: usize| Err(Error::argument("row 7 is broken"));
    let options = PcaOptions { components: 3, ..PcaOptions::default() };
    let message = Pca::fit(10, 20, &options, &row, &mut silent).unwrap_err().to_string();
    assert!(message.contains("row 7"), "{message}");
}
