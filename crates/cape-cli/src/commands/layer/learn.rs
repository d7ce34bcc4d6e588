use std::path::PathBuf;

use cape_core::{Mesh, ply};
use cape_layer::{
    AssociateOptions, Association, Layer, LayerSet, StandardPose,
    experiment::{LayerError, Unposed},
    geometry::Surface,
    regress::{Features, Training},
};
use cape_train::write_json;
use clap::Args;
use serde::Serialize;

use super::body;
use crate::{
    arguments::{Global, at_least_one},
    console::Console,
    dressed::eight_bit,
    error::{Error, Result},
    files,
    table::Table,
};

/// Tie clothing to the body, and learn to predict it.
///
/// Writes layer.npz, which `cape layer predict` takes, the reconstruction errors by number of
/// components and the errors of regression (tables 1 and 2 of the paper) in layer.json, and the
/// association as coloured meshes.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  cape layer learn skirt --components 40 --out learnt")]
pub(super) struct Learn {
    /// Sequences that `cape layer synth` or `cape_layer::LayerSet` wrote.
    #[arg(value_name = "SET")]
    set: PathBuf,
    /// Directory to write; it must be empty or missing.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// The body, .pkl or .npz; by default the synthetic one.
    #[arg(long, value_name = "SMPL")]
    body: Option<PathBuf>,
    /// Principal components that are predicted.
    #[arg(long, default_value_t = 40, value_name = "N", value_parser = at_least_one)]
    components: usize,
    /// Body vertices for each clothing vertex.
    #[arg(long, default_value_t = 4, value_name = "N", value_parser = at_least_one)]
    neighbours: usize,
    /// Frame, counted over all sequences, in which clothing is tied to the body.
    #[arg(long, default_value_t = 0, value_name = "K")]
    frame: usize,
}

#[derive(Debug, Serialize)]
struct Errors {
    mean_mm: f64,
    largest_mm: f64,
}

impl From<LayerError> for Errors {
    fn from(LayerError { mean, largest }: LayerError) -> Self {
        Self { mean_mm: mean, largest_mm: largest }
    }
}

#[derive(Debug, Serialize)]
struct Row {
    sequence: String,
    frames: usize,
    /// With 1, 5, as many as are predicted, and all components.
    errors: Vec<Errors>,
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    clothing_vertices: usize,
    pairs: usize,
    completed_vertices: usize,
    components: usize,
    explained: f64,
    counts: Vec<usize>,
    reconstruction: Vec<Row>,
    train: Errors,
    predict: Errors,
}

impl Learn {
    pub(super) fn run(self, global: &Global, console: Console) -> Result {
        files::require_empty(&self.out)?;
        let model = body(self.body.as_deref())?;
        let set = LayerSet::load(&self.set)?;
        let each = set.each_frame();
        let &(first, frame) = each.get(self.frame).ok_or_else(|| {
            Error::message(format!("--frame {}: there are {}", self.frame, each.len()))
        })?;
        let standard = StandardPose::default();
        let under = set.sequences[first].body(&model, frame, &standard)?;
        let under = Surface::new("body", under.posed, model.faces.clone())?;
        let over = set.clothing(first, frame)?;
        let options =
            AssociateOptions { neighbours: self.neighbours, ..AssociateOptions::default() };
        let association = options.associate(&under, &over)?;

        let unposed = Unposed::new(&model, &set, &association, standard.clone())?;
        let mut counts = vec![1, 5, self.components];
        counts.sort_unstable();
        counts.dedup();
        let table = unposed.reconstruction(&counts)?;
        let features = Features::default();
        let training = Training { seed: global.seed.unwrap_or(1), ..Training::default() };
        let learnt = unposed.regression(self.components, &features, &training, &mut |_| {})?;

        files::create_dir(&self.out)?;
        let parameters = set.sequences[first].parameters.iter().map(|(name, _)| name.clone());
        let layer = Layer {
            faces: set.faces.clone(),
            association: association.clone(),
            standard,
            pca: learnt.pca.clone(),
            features,
            parameters: parameters.collect(),
            regressor: learnt.outcome.regressor.clone(),
        };
        layer.save(self.out.join("layer.npz"))?;
        self.draw(&under, &over, &association)?;
        let rows = set.sequences.iter().zip(table).map(|(sequence, errors)| Row {
            sequence: sequence.name.clone(),
            frames: sequence.frames(),
            errors: errors.into_iter().map(Errors::from).collect(),
        });
        let report = Report {
            clothing_vertices: association.clothing_vertices(),
            pairs: association.pairs,
            completed_vertices: association.completion.total(),
            components: self.components,
            explained: learnt.pca.explained(),
            reconstruction: rows.collect(),
            counts,
            train: learnt.train.into(),
            predict: learnt.predict.into(),
            out: self.out,
        };
        write_json(&report.out.join("layer.json"), &report)?;
        console.result(&report, || report.text())
    }

    /// Both meshes in colours by place on the body: what is tied to each other looks the same.
    fn draw(&self, body: &Surface, clothing: &Surface, association: &Association) -> Result {
        let mesh = body.to_mesh();
        let [low, high] = mesh.bounding_box().ok_or_else(|| Error::message("an empty body"))?;
        let colour = |v: &[f32; 3]| {
            [0, 1, 2].map(|i| (v[i] - low[i]) / (high[i] - low[i]).max(f32::MIN_POSITIVE))
        };
        let of_body: Vec<[f32; 3]> = mesh.vertices.iter().map(colour).collect();
        let pairs = association.indices.rows().into_iter().zip(association.weights.rows());
        let of_clothing: Vec<[f32; 3]> = pairs
            .map(|(indices, weights)| {
                let mut sum = [0.0; 3];
                for (&index, &weight) in indices.iter().zip(weights) {
                    let part = of_body.get(index as usize).copied().unwrap_or_default();
                    sum.iter_mut().zip(part).for_each(|(s, c)| *s += weight as f32 * c);
                }
                sum
            })
            .collect();
        let write = |name: &str, mesh: &Mesh, colours: &[[f32; 3]]| {
            let colours: Vec<[u8; 3]> = colours.iter().copied().map(eight_bit).collect();
            ply::write(self.out.join(name), mesh, Some(&colours))
        };
        write("body.ply", &mesh, &of_body)?;
        Ok(write("clothing.ply", &clothing.to_mesh(), &of_clothing)?)
    }
}

impl Report {
    fn text(&self) -> String {
        let heads: Vec<String> = ["sequence".to_owned(), "frames".to_owned()]
            .into_iter()
            .chain(self.counts.iter().map(|count| format!("{count} components")))
            .chain(["all".to_owned()])
            .collect();
        let mut table = Table::new(heads);
        for row in &self.reconstruction {
            let errors = row.errors.iter().map(|errors| format!("{:.2}", errors.mean_mm));
            let cells = [row.sequence.clone(), row.frames.to_string()].into_iter().chain(errors);
            table.row(cells);
        }
        format!(
            "{}\n\nmean error of reconstruction, mm\n\n{} clothing vertices tied by {} pairs, {} \
             completed\n{} components hold {:.1} % of the variance\nregression: {:.2} mm over \
             frames that trained, {:.2} mm over others\n{}",
            table.text(),
            self.clothing_vertices,
            self.pairs,
            self.completed_vertices,
            self.components,
            100.0 * self.explained,
            self.train.mean_mm,
            self.predict.mean_mm,
            self.out.join("layer.npz").display()
        )
    }
}
