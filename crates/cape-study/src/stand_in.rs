//! A classifier in place of raters, for development.

use std::path::Path;

use cape_core::{Error, Result};
use cape_render::Image;

use crate::{Answer, PairKind, StudyDesign, Trial, design::STIMULI};

/// Name of the stand-in among raters.
pub const STAND_IN: &str = "stand-in";

/// Cells of the features, horizontal and vertical.
const CELLS: [usize; 2] = [12, 18];
const FOLDS: usize = 5;
/// Steps and rate of the gradient descent, and weight of the squared coefficients.
const STEPS: usize = 300;
const RATE: f64 = 0.5;
const RIDGE: f64 = 1e-2;

/// Answers of a logistic regression on the gradients of the pictures, which is no person: it learns on
/// four fifths of the scored pairs which side is real, and answers for the others.
///
/// # Errors
/// If there are fewer than ten scored pairs, or a picture cannot be read.
pub fn stand_in_answers(design: &StudyDesign, directory: impl AsRef<Path>) -> Result<Vec<Answer>> {
    let pairs = design.of_kind(PairKind::Scored);
    if pairs.len() < 2 * FOLDS {
        return Err(Error::argument(format!(
            "{} scored pairs: the stand-in classifier needs at least {}",
            pairs.len(),
            2 * FOLDS
        )));
    }
    let directory = directory.as_ref().join(STIMULI);
    let read = |file: &str| -> Result<Vec<f64>> {
        let path = directory.join(file);
        let image = Image::load(&path).map_err(|error| Error::format(&path, error.to_string()))?;
        Ok(features(&image))
    };
    let mut differences = Vec::with_capacity(pairs.len());
    for &pair in &pairs {
        let known = &design.pairs[pair];
        let (real, generated) = (read(&known.real.file)?, read(&known.generated.file)?);
        differences.push(real.iter().zip(generated).map(|(a, b)| a - b).collect::<Vec<f64>>());
    }
    let scale = mean_length(&differences);
    for value in differences.iter_mut().flatten() {
        *value /= scale;
    }
    let mut answers = Vec::with_capacity(pairs.len());
    for fold in 0..FOLDS {
        let training: Vec<&[f64]> = differences
            .iter()
            .enumerate()
            .filter(|(index, _)| index % FOLDS != fold)
            .map(|(_, difference)| &difference[..])
            .collect();
        let weights = fit(&training);
        for index in (fold..pairs.len()).step_by(FOLDS) {
            let pair = &design.pairs[pairs[index]];
            let right = dot(&weights, &differences[index]) > 0.0;
            let chosen = if right { &pair.real } else { &pair.generated };
            let [left, other] = pair.files().map(ToOwned::to_owned);
            answers.push(Answer {
                rater: STAND_IN.into(),
                trial: Trial { pair: pairs[index], left, right: other },
                chosen: chosen.file.clone(),
                rt_ms: 1000.0,
            });
        }
    }
    answers.sort_by_key(|answer| answer.trial.pair);
    Ok(answers)
}

/// Means of the absolute horizontal and vertical differences of brightness in each cell.
fn features(image: &Image) -> Vec<f64> {
    let (width, height) = (image.width() as usize, image.height() as usize);
    let brightness = |x: usize, y: usize| {
        let [r, g, b, _] = image.pixels()[y * width + x].map(f64::from);
        (r + g + b) / 765.0
    };
    let mut sums = vec![0.0; 2 * CELLS[0] * CELLS[1]];
    for y in 1..height {
        for x in 1..width {
            let cell = (y * CELLS[1] / height) * CELLS[0] + x * CELLS[0] / width;
            sums[2 * cell] += (brightness(x, y) - brightness(x - 1, y)).abs();
            sums[2 * cell + 1] += (brightness(x, y) - brightness(x, y - 1)).abs();
        }
    }
    sums
}

/// Coefficients by which differences real minus generated are positive. The model has no constant term,
/// since sides are arbitrary.
fn fit(differences: &[&[f64]]) -> Vec<f64> {
    let mut weights = vec![0.0; differences.first().map_or(0, |first| first.len())];
    for _ in 0..STEPS {
        let mut gradient: Vec<f64> = weights.iter().map(|weight| -RIDGE * weight).collect();
        for difference in differences {
            let miss = 1.0 / (1.0 + dot(&weights, difference).exp());
            let step = miss / differences.len() as f64;
            for (gradient, value) in gradient.iter_mut().zip(*difference) {
                *gradient += step * value;
            }
        }
        for (weight, gradient) in weights.iter_mut().zip(gradient) {
            *weight += RATE * gradient;
        }
    }
    weights
}

fn mean_length(rows: &[Vec<f64>]) -> f64 {
    let mean = rows.iter().map(|row| dot(row, row).sqrt()).sum::<f64>() / rows.len() as f64;
    if mean > 0.0 { mean } else { 1.0 }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use std::fs;

    use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

    use super::*;
    use crate::simulation::tests::design;

    /// Share of noisy pictures that are taken for smooth ones, when noise has these amplitudes.
    fn fooled(real: u8, generated: u8) -> f64 {
        let design = design(60, 0, 0, 60);
        let directory = tempfile::tempdir().unwrap();
        fs::create_dir(directory.path().join(STIMULI)).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for pair in &design.pairs {
            for (stimulus, amplitude) in [(&pair.real, real), (&pair.generated, generated)] {
                let mut image = Image::new(36, 54, [0, 0, 0, 255]).unwrap();
                for pixel in image.pixels_mut() {
                    let grey = 100 + rng.random_range(0..=amplitude);
                    *pixel = [grey, grey, grey, 255];
                }
                image.save(directory.path().join(STIMULI).join(&stimulus.file)).unwrap();
            }
        }
        let answers = stand_in_answers(&design, directory.path()).unwrap();
        assert_eq!(answers.len(), 60);
        answers.iter().filter(|answer| answer.is_fooled(&design)).count() as f64 / 60.0
    }

    #[test]
    fn it_tells_noise_from_none_and_guesses_between_equals() {
        assert!(fooled(10, 40) < 0.05);
        let guessed = fooled(30, 30);
        assert!((0.25..0.75).contains(&guessed), "{guessed}");
    }
}
