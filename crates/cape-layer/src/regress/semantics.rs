use cape_core::npy::{Npz, NpzWriter};
use ndarray::{Array1, Array2, ArrayView1, ArrayView2, Axis};
use rand::{RngExt, rngs::ChaCha8Rng};
use rand_distr::StandardNormal;

use super::regressor::Standardiser;
use crate::{ComponentSelection, Error, Pca, Result, sequence::beta_name};
use cape_core::expect_finite;

/// Largest number of shape coefficients of a body.
const BETAS: usize = 300;

/// Random parameters are at most this many standard deviations from the mean along each component.
const FARTHEST: f64 = 2.0;

/// Standard deviation below which a parameter is constant up to rounding, relative to its mean or to 1.
const NEGLIGIBLE: f64 = 1e-9;

/// Semantic parameters of sequences (garment sizes, §5.3, and materials, §5.2) as inputs of the
/// regression: standardised, and reduced to principal components if many vary. The paper reduces
/// the 39 parameters of a material to 4.
///
/// ```
/// use cape_layer::regress::SemanticParameters;
/// use ndarray::arr2;
///
/// // Two sequences of different garment length and equal width.
/// let names = vec!["length".to_owned(), "width".to_owned()];
/// let semantics = SemanticParameters::from_rows(names, arr2(&[[0.8, 1.1], [1.2, 1.1]]).view(), None)?;
/// // Other parameters keep their mean, which reduces to zeros.
/// let parameters = semantics.with(&[("length".into(), 1.0)])?;
/// assert!((parameters[1] - 1.1).abs() < 1e-9);
/// assert!(semantics.reduced(&parameters)?.iter().all(|number| number.abs() < 1e-9));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct SemanticParameters {
    names: Vec<String>,
    scale: Standardiser,
    /// Components in the space of standardised parameters, `[inputs, parameters]`.
    components: Array2<f64>,
    /// Principal directions of the parameters of the training sequences, each one standard deviation long,
    /// in the units of the parameters, `[directions, parameters]`; not in the files of earlier versions.
    spread: Option<Array2<f64>>,
}

impl SemanticParameters {
    /// Statistics of the parameters of sequences, `[sequences, names]`. If more than `most`
    /// parameters vary, they are reduced to `most` principal components, but at most sequences less
    /// one.
    ///
    /// # Errors
    /// If there is not one name for each parameter, or a parameter is not finite.
    pub fn from_rows(
        names: Vec<String>,
        sequences: ArrayView2<'_, f64>,
        most: Option<usize>,
    ) -> Result<Self> {
        if names.len() != sequences.ncols() {
            return Err(Error::argument(format!(
                "semantic parameters: {} names for {} parameters",
                names.len(),
                sequences.ncols()
            )));
        }
        expect_finite("semantic parameters", sequences)?;
        let scale = Standardiser::from_rows(sequences, &vec![0.0; sequences.ncols()]);
        let standardised = scale.apply(sequences);
        let varied = standardised.columns().into_iter().filter(|c| c.iter().any(|&x| x != 0.0));
        let components = match most {
            Some(most) if varied.count() > most => {
                let most = most.min(sequences.nrows() - 1);
                let keep = ComponentSelection::Components(most);
                Pca::from_snapshots(standardised.view(), keep)?.components
            }
            _ => Array2::eye(names.len()),
        };
        let spread = if sequences.nrows() > 1 && !names.is_empty() {
            let pca = Pca::from_snapshots(standardised.view(), ComponentSelection::All)?;
            let deviations = pca.variances.mapv(|variance| variance.max(0.0).sqrt());
            scale.scaled(&(pca.components * deviations.insert_axis(Axis(1))))
        } else {
            Array2::zeros((0, names.len()))
        };
        Ok(Self { names, scale, components, spread: Some(spread) })
    }

    /// Names of the parameters, in order.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Standard deviations of the parameters over the training sequences, in order, `[parameters]`: 0 for those
    /// that did not differ, and for all of a layer that an earlier version learned.
    pub fn deviations(&self) -> Vec<f64> {
        let Some(spread) = &self.spread else { return vec![0.0; self.names.len()] };
        let deviation = |(column, mean): (ArrayView1<'_, f64>, &f64)| {
            let deviation = column.dot(&column).sqrt();
            if deviation > NEGLIGIBLE * mean.abs().max(1.0) { deviation } else { 0.0 }
        };
        spread.columns().into_iter().zip(self.scale.mean()).map(deviation).collect()
    }

    /// Number of inputs of the regression.
    pub fn len(&self) -> usize {
        self.components.nrows()
    }

    /// True if there is no input.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Inputs of the regression, `[len]`, of parameters in the order of [`names`](Self::names).
    ///
    /// # Errors
    /// If the number of parameters differs, or one is not finite.
    pub fn reduced(&self, parameters: &[f64]) -> Result<Vec<f64>> {
        if parameters.len() != self.names.len() {
            return Err(Error::argument(format!(
                "semantic parameters: {} values, expected {}: {}",
                parameters.len(),
                self.names.len(),
                self.names.join(", ")
            )));
        }
        expect_finite("semantic parameters", parameters)?;
        let row = Array1::from_vec(parameters.to_vec()).insert_axis(Axis(0));
        Ok(self.scale.apply(row.view()).dot(&self.components.t()).into_iter().collect())
    }

    /// [`with`](Self::with), and the shape coefficients of the wearer, from the first on, in place of those
    /// that are among the parameters and not named.
    ///
    /// # Errors
    /// As of `with`.
    pub fn with_wearer(&self, named: &[(String, f64)], betas: &[f64]) -> Result<Vec<f64>> {
        let mut parameters = self.with(named)?;
        for (parameter, beta) in parameters.iter_mut().zip(self.wearers(named, betas)) {
            *parameter = beta.unwrap_or(*parameter);
        }
        Ok(parameters)
    }

    /// [`with_wearer`](Self::with_wearer) with random values in place of the mean (figure 8 of the paper): of
    /// the normal distribution of the training sequences' parameters, along their principal components, at
    /// most two standard deviations from the mean along each.
    ///
    /// # Errors
    /// As of `with`, or if no other parameters differed between the training sequences.
    pub fn random_with_wearer(
        &self,
        named: &[(String, f64)],
        betas: &[f64],
        rng: &mut ChaCha8Rng,
    ) -> Result<Vec<f64>> {
        let fixed = self.with(named)?;
        let Some(spread) = &self.spread else {
            return Err(Error::argument(
                "random parameters: the layer was learned by an earlier version, which did not record \
                 how they vary; learn it again",
            ));
        };
        let wearers = self.wearers(named, betas);
        let given = |at: usize| named.iter().any(|(name, _)| *name == self.names[at]);
        let deviations = self.deviations();
        let is_drawn = |&at: &usize| !given(at) && wearers[at].is_none() && deviations[at] > 0.0;
        let drawn: Vec<usize> = (0..self.names.len()).filter(is_drawn).collect();
        if drawn.is_empty() {
            return Err(Error::argument(
                "random parameters: no other parameters than those given and the wearer's shape differed \
                 between the training sequences",
            ));
        }
        let steps: Array1<f64> = (0..spread.nrows()).map(|_| bounded_normal(rng)).collect();
        let random = self.scale.mean() + &steps.dot(spread);
        let value = |at: usize| match wearers[at] {
            Some(beta) => beta,
            None if drawn.contains(&at) => random[at],
            None => fixed[at],
        };
        Ok((0..self.names.len()).map(value).collect())
    }

    /// Shape coefficient of the wearer for each parameter that is one and is not named, `[parameters]`.
    fn wearers(&self, named: &[(String, f64)], betas: &[f64]) -> Vec<Option<f64>> {
        let beta = |name: &String| {
            let given = named.iter().any(|(known, _)| known == name);
            let shape = (0..BETAS).find(|&k| *name == beta_name(k));
            shape.filter(|_| !given).map(|k| betas.get(k).copied().unwrap_or(0.0))
        };
        self.names.iter().map(beta).collect()
    }

    /// All parameters in order, some given by name; the others have the mean of the training set.
    ///
    /// # Errors
    /// If a name is not known.
    pub fn with(&self, named: &[(String, f64)]) -> Result<Vec<f64>> {
        let mut parameters = self.scale.mean().to_vec();
        for (name, value) in named {
            let Some(at) = self.names.iter().position(|known| known == name) else {
                return Err(Error::argument(format!(
                    "semantic parameter `{name}` is unknown: expected {}",
                    if self.names.is_empty() { "none".into() } else { self.names.join(", ") }
                )));
            };
            parameters[at] = *value;
        }
        Ok(parameters)
    }

    /// Adds the arrays to an archive.
    pub(crate) fn write(&self, file: &mut NpzWriter) -> Result<()> {
        let names: Array1<i64> = self.names.join("\n").bytes().map(i64::from).collect();
        file.add("semantic_names", &names)?;
        self.scale.write(file, "semantic")?;
        file.add("semantic_components", &self.components)?;
        if let Some(spread) = &self.spread {
            file.add("semantic_spread", spread)?;
        }
        Ok(())
    }

    /// Reads the arrays that [`write`](Self::write) added.
    pub(crate) fn read(file: &mut Npz) -> Result<Self> {
        let path = file.path().to_owned();
        let fault = |field: &str, message: String| cape_core::Error::field(&path, field, message);
        let bytes: Vec<u8> = file
            .i64("semantic_names")?
            .iter()
            .map(|&b| u8::try_from(b).map_err(|e| fault("semantic_names", e.to_string())))
            .collect::<Result<_, _>>()?;
        let text = String::from_utf8(bytes).map_err(|e| fault("semantic_names", e.to_string()))?;
        let names: Vec<String> = text.lines().map(str::to_owned).collect();
        let scale = Standardiser::read(file, "semantic")?;
        let has_spread = file.contains("semantic_spread");
        file.expect_shape("semantic_mean", &[scale.mean().len()], &[Some(names.len())])?;
        let mut matrix = |of: &str| -> Result<Array2<f64>> {
            let numbers = file.f64(of)?;
            file.expect_shape(of, numbers.shape(), &[None, Some(names.len())])?;
            expect_finite(of, &numbers)?;
            Ok(numbers.into_dimensionality().map_err(|e| fault(of, e.to_string()))?)
        };
        let components = matrix("semantic_components")?;
        let spread = if has_spread { Some(matrix("semantic_spread")?) } else { None };
        Ok(Self { names, scale, components, spread })
    }
}

/// A standard normal number that is at most [`FARTHEST`] from 0.
fn bounded_normal(rng: &mut ChaCha8Rng) -> f64 {
    loop {
        let number: f64 = rng.sample(StandardNormal);
        if number.abs() <= FARTHEST {
            return number;
        }
    }
}

#[cfg(test)]
mod tests {
    use ndarray::arr2;
    use rand::SeedableRng;

    use super::*;

    fn names(count: usize) -> Vec<String> {
        (0..count).map(|k| format!("p{k}")).collect()
    }

    #[test]
    fn few_parameters_are_standardised_and_many_reduced() {
        let rows = arr2(&[[1.0, 5.0, 0.0], [3.0, 5.0, 4.0], [5.0, 5.0, 8.0], [7.0, 5.0, 12.0]]);
        let plain = SemanticParameters::from_rows(names(3), rows.view(), Some(2)).unwrap();
        assert_eq!(plain.len(), 3, "only two vary");
        let seen = plain.reduced(&[4.0, 5.0, 6.0]).unwrap();
        assert!(seen.iter().all(|x| x.abs() < 1e-12), "the mean: {seen:?}");
        // Two proportional parameters reduce to one number.
        let reduced = SemanticParameters::from_rows(names(3), rows.view(), Some(1)).unwrap();
        assert_eq!(reduced.len(), 1);
        let [a, b] = [[1.0, 5.0, 0.0], [7.0, 5.0, 12.0]].map(|p| reduced.reduced(&p).unwrap()[0]);
        assert!((a + b).abs() < 1e-9 && (a.abs() - 1.8f64.sqrt() * 2f64.sqrt()).abs() < 1e-9);
    }

    #[test]
    fn shape_coefficients_are_the_wearers() {
        let names = ["length", "beta_1", "beta_3"].map(str::to_owned).to_vec();
        let rows = arr2(&[[1.0, 0.0, -1.0], [2.0, 1.0, 1.0]]);
        let semantics = SemanticParameters::from_rows(names, rows.view(), None).unwrap();
        assert_eq!(semantics.with_wearer(&[], &[0.5, 9.0, -2.0]).unwrap(), [1.5, 0.5, -2.0]);
        let named = [("beta_3".to_owned(), 0.25)];
        assert_eq!(semantics.with_wearer(&named, &[]).unwrap(), [1.5, 0.0, 0.25]);
    }

    #[test]
    fn random_parameters_are_distributed_as_those_of_the_sequences() {
        let names = ["length", "width", "friction", "beta_1"].map(str::to_owned).to_vec();
        // Width follows length, friction is constant.
        let rows = arr2(&[
            [0.8, 1.0, 0.3, -1.0],
            [1.0, 1.1, 0.3, 1.0],
            [1.2, 1.2, 0.3, -1.0],
            [1.0, 1.1, 0.3, 1.0],
        ]);
        let semantics = SemanticParameters::from_rows(names, rows.view(), None).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut draw = |named: &[(String, f64)]| {
            semantics.random_with_wearer(named, &[0.5], &mut rng).unwrap()
        };
        let found: Vec<Vec<f64>> = (0..2000).map(|_| draw(&[])).collect();
        for row in &found {
            assert!((row[1] - (0.6 + 0.5 * row[0])).abs() < 1e-9, "on the line: {row:?}");
            assert!((row[2] - 0.3).abs() < 1e-12 && row[3] == 0.5, "{row:?}");
            // Two standard deviations of the length, 0.02 m².
            assert!((row[0] - 1.0).abs() <= 2.0 * 0.02f64.sqrt() + 1e-9, "{row:?}");
        }
        let deviations = semantics.deviations();
        assert!((deviations[0] - 0.02f64.sqrt()).abs() < 1e-12 && deviations[2] == 0.0);
        let mean = found.iter().map(|row| row[0]).sum::<f64>() / 2000.0;
        let variance = found.iter().map(|row| (row[0] - 1.0).powi(2)).sum::<f64>() / 2000.0;
        // A normal distribution cut off at two deviations has 0.774 of the variance.
        assert!((mean - 1.0).abs() < 0.012 && (variance / 0.02 - 0.774).abs() < 0.06, "{variance}");
        let named = [("length".to_owned(), 0.9)];
        let (one, other) = (draw(&named), draw(&named));
        assert!(one[0] == 0.9 && other[0] == 0.9 && one[1] != other[1]);
        let all = [("length".to_owned(), 0.9), ("width".to_owned(), 1.0)];
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let refused = semantics.random_with_wearer(&all, &[], &mut rng).unwrap_err().to_string();
        assert!(refused.contains("no other parameters"), "{refused}");
        let one = arr2(&[[1.0]]);
        let alone = SemanticParameters::from_rows(vec!["length".into()], one.view(), None).unwrap();
        assert!(alone.random_with_wearer(&[], &[], &mut rng).is_err());
        let earlier = SemanticParameters { spread: None, ..semantics };
        let refused = earlier.random_with_wearer(&[], &[], &mut rng).unwrap_err().to_string();
        assert!(refused.contains("earlier version"), "{refused}");
    }

    #[test]
    fn parameters_are_named() {
        let rows = arr2(&[[1.0, 2.0], [3.0, 4.0]]);
        let semantics = SemanticParameters::from_rows(names(2), rows.view(), None).unwrap();
        assert_eq!(semantics.with(&[("p1".into(), 9.0)]).unwrap(), [2.0, 9.0]);
        let unknown = semantics.with(&[("q".into(), 1.0)]).unwrap_err().to_string();
        assert!(unknown.contains("`q`") && unknown.contains("p0, p1"), "{unknown}");
        assert!(semantics.reduced(&[1.0]).unwrap_err().to_string().contains("expected 2: p0, p1"));
        assert!(semantics.reduced(&[1.0, f64::NAN]).is_err());
        assert!(SemanticParameters::from_rows(names(1), rows.view(), None).is_err());
    }
}
