//! Agreement between raters.

/// Krippendorff's alpha of ratings `[units][raters of the unit]` of two categories: 1 for full agreement,
/// 0 for chance. Units with one rating tell nothing; `None` if no unit has two, or if all ratings are
/// equal.
///
/// ```
/// use cape_study::krippendorff_alpha;
///
/// let units = [vec![true, true, true], vec![false, false], vec![true]];
/// assert_eq!(krippendorff_alpha(&units), Some(1.0));
/// ```
pub fn krippendorff_alpha(units: &[Vec<bool>]) -> Option<f64> {
    // Sums of the coincidence matrix.
    let (mut disagreeing, mut ones, mut total) = (0.0, 0.0, 0.0);
    for unit in units.iter().filter(|unit| unit.len() > 1) {
        let count = unit.len() as f64;
        let one = unit.iter().filter(|&&rating| rating).count() as f64;
        disagreeing += 2.0 * one * (count - one) / (count - 1.0);
        ones += one;
        total += count;
    }
    let expected = 2.0 * ones * (total - ones) / (total - 1.0);
    (expected > 0.0).then(|| 1.0 - disagreeing / expected)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The binary example of Krippendorff's "Computing Krippendorff's Alpha-Reliability".
    #[test]
    fn the_published_example() {
        let meg = [0, 1, 0, 0, 0, 0, 0, 0, 1, 0];
        let owen = [1, 1, 1, 0, 0, 1, 0, 0, 0, 0];
        let units: Vec<Vec<bool>> =
            meg.iter().zip(owen).map(|(&a, b)| vec![a == 1, b == 1]).collect();
        let alpha = krippendorff_alpha(&units).unwrap();
        assert!((alpha - 0.095).abs() < 5e-4, "{alpha}");
    }

    #[test]
    fn nothing_to_compare() {
        assert_eq!(krippendorff_alpha(&[]), None);
        assert_eq!(krippendorff_alpha(&[vec![true], vec![false]]), None);
        assert_eq!(krippendorff_alpha(&[vec![true, true]]), None);
    }
}
