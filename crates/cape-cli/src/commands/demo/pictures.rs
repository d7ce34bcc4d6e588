use cape_core::Outfit;
use cape_render::{Image, Plot, Series, Tile, View, contact_sheet as lay_out};
use cape_train::TrainEvent;

use crate::{dressed_mesh::DressedMesh, error::Result};

/// Poses of the contact sheet, one per row, and their views.
pub(super) const POSES: [(&str, View); 2] = [("a-pose", View::Front), ("walk", View::ThreeQuarter)];

const TILE: [u32; 2] = [240, 352];

/// Contact sheet with a row per pose: the bare body, then the outfits.
pub(super) fn contact_sheet(rows: &[(View, Vec<DressedMesh>)]) -> Result<Image> {
    let mut tiles = Vec::new();
    let labels = ["body"].into_iter().chain(Outfit::PAPER.iter().map(Outfit::name));
    let labels: Vec<&str> = labels.collect();
    for (row, (view, bodies)) in rows.iter().enumerate() {
        let last = row + 1 == rows.len();
        for (body, label) in bodies.iter().zip(&labels) {
            let label = if last { (*label).to_owned() } else { String::new() };
            tiles.push(Tile { image: body.picture(*view, TILE, None)?, label });
        }
    }
    Ok(lay_out(&tiles, labels.len(), None)?)
}

/// Losses by step.
#[derive(Debug, Clone, Default)]
pub(super) struct LossCurves {
    train: Vec<(f64, f64)>,
    edge: Vec<(f64, f64)>,
    validation: Vec<(f64, f64)>,
    step: f64,
}

impl LossCurves {
    pub(super) fn on_event(&mut self, event: &TrainEvent) {
        match event {
            TrainEvent::Step { total_step, losses, .. } => {
                self.step = *total_step as f64;
                self.train.push((self.step, losses.reconstruction));
                self.edge.push((self.step, losses.edge));
            }
            TrainEvent::Validation { losses, .. } => {
                self.validation.push((self.step, losses.reconstruction));
            }
            TrainEvent::Prior { .. } | TrainEvent::Checkpoint { .. } => {}
        }
    }

    pub(super) fn plot(&self) -> Result<Image> {
        let series = |name: &str, points: &[(f64, f64)]| Series {
            name: name.to_owned(),
            points: points.to_vec(),
        };
        let plot = Plot {
            title: "Training".into(),
            x_label: "step".into(),
            y_label: "normalised displacements".into(),
            log_y: true,
            series: vec![
                series("reconstruction", &self.train),
                series("edge", &self.edge),
                series("validation", &self.validation),
            ],
        };
        Ok(plot.draw(900, 540)?)
    }
}
