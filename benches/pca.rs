//! Principal components of as many frames as the male training set has, 31,036 of 6890 vertices:
//! more than most memories hold. Frames are made as they are read, of smooth fields with falling
//! variance and noise.

use std::time::Instant;

use cape::{
    eval::bench::peak_rss_mb,
    stats::pca::{Pca, PcaOptions},
};

const FRAMES: usize = 31_036;
const NUMBERS: usize = 3 * 6890;
/// Fields that frames are made of.
const FIELDS: usize = 96;

fn main() {
    let fields: Vec<Vec<f64>> = (0..FIELDS)
        .map(|k| {
            let size = 0.02 * (-0.08 * k as f64).exp();
            let wave = move |i: usize| size * (i as f64 * 0.0007 * (k + 1) as f64 + k as f64).sin();
            (0..NUMBERS).map(wave).collect()
        })
        .collect();
    let row = |frame: usize| {
        let mut values = vec![0.0; NUMBERS];
        // Every frame is of a dozen fields, so that making it is not what takes the time.
        for part in 0..12 {
            let field = (frame * 31 + part * part * 7 + part) % FIELDS;
            let weight = ((frame * 13 + part * 101) as f64 * 0.61).sin();
            for (value, x) in values.iter_mut().zip(&fields[field]) {
                *value += weight * x;
            }
        }
        Ok(values)
    };
    let start = Instant::now();
    let mut rows = 0;
    let options = PcaOptions::default();
    let pca = Pca::fit(FRAMES, NUMBERS, &options, &row, &mut |done, total| {
        rows += usize::from(done == total);
    })
    .unwrap();
    println!(
        "{FRAMES} frames of {NUMBERS} numbers, {} components: {:.0} s, {rows} passes, residual \
         {:.1e}, {:.1} % of the variance, {:.0} MB at most",
        pca.latent(),
        start.elapsed().as_secs_f64(),
        pca.residual,
        100.0 * pca.explained(),
        peak_rss_mb().unwrap_or(f64::NAN)
    );
}
