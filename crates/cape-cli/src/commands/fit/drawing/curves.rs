use cape_fit::{BodyFit, ClothedFit};
use cape_render::{Image, Plot, Series, Tile, contact_sheet};

use crate::error::Result;

const WIDTH: u32 = 760;
const HEIGHT: u32 = 420;

/// Energies of both stages by step, a curve per minimisation.
pub(crate) fn energies(bare: &BodyFit, clothed: &ClothedFit) -> Result<Image> {
    let tiles = [("SMPLify", &bare.curves), ("CAPE", &clothed.curves)]
        .map(|(title, curves)| {
            let image = plot(title, curves).draw(WIDTH, HEIGHT)?;
            Ok(Tile { image, label: String::new() })
        })
        .into_iter()
        .collect::<Result<Vec<_>>>()?;
    Ok(contact_sheet(&tiles, 2, None)?)
}

fn plot(title: &str, curves: &[Vec<f64>]) -> Plot {
    let mut series = Vec::new();
    let mut first = 0;
    for (index, curve) in curves.iter().enumerate() {
        let points = curve.iter().enumerate().map(|(step, &e)| ((first + step) as f64, e));
        series.push(Series { name: format!("{}", index + 1), points: points.collect() });
        first += curve.len().saturating_sub(1);
    }
    Plot {
        title: title.into(),
        x_label: "steps".into(),
        y_label: "energy".into(),
        log_y: true,
        series,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn descents_follow_one_another() {
        let plot = plot("", &[vec![4.0, 2.0, 1.0], vec![3.0, 0.5]]);
        assert_eq!(plot.series[0].points, [(0.0, 4.0), (1.0, 2.0), (2.0, 1.0)]);
        assert_eq!(plot.series[1].points, [(2.0, 3.0), (3.0, 0.5)]);
    }
}
