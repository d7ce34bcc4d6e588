use std::path::PathBuf;

use cape_infer::write_json;
use cape_layer::{
    LayerSet,
    experiment::{LayerError, UnposedSet},
};
use clap::Args;
use serde::Serialize;

use super::{
    associate,
    association::{AssociationArgs, LearningArgs},
    body,
};
use crate::{arguments::GlobalArgs, console::Console, error::Result, files, table::Table};

/// Tie clothing to the body, and learn to predict it.
///
/// Writes layer.npz, which `cape layer predict` takes, the reconstruction errors by number of
/// components and the errors of regression (tables 1 and 2 of the paper) in layer.json, and the
/// association as coloured meshes and a picture.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  cape layer learn skirt --components 40 --out learnt")]
pub(super) struct LearnArgs {
    /// Sequences that `cape layer synth` or `cape layer import` wrote.
    #[arg(value_name = "SET")]
    set: PathBuf,
    /// Directory to write; it must be empty or missing.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// The body, .pkl or .npz; by default the synthetic one.
    #[arg(long, value_name = "SMPL")]
    body: Option<PathBuf>,
    #[command(flatten)]
    association_args: AssociationArgs,
    #[command(flatten)]
    learning_args: LearningArgs,
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

impl LearnArgs {
    pub(super) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        files::require_empty(&self.out)?;
        let model = body(self.body.as_deref())?;
        let set = LayerSet::load(&self.set)?;
        let components = self.learning_args.components;
        let learning = self.learning_args.learning(global.seed.unwrap_or(1))?;
        let tied = self.association_args.associate(&model, &set, console)?;
        let association = &tied.association;
        let unposed =
            UnposedSet::new(&model, &set, association, &self.association_args.standard())?;
        let mut counts = vec![1, 5, components];
        counts.sort_unstable();
        counts.dedup();
        let all: Vec<usize> = (0..set.sequences.len()).collect();
        let regression = console.while_showing("learn", "iterations", |progress| {
            let most = learning.training.minimiser.steps;
            unposed.regression(&all, &learning, &mut |epoch| progress(epoch.iteration, most))
        })?;
        let table = console.while_showing("measure", "sequences", |progress| {
            let measure = |&sequence: &usize| {
                let errors = unposed.reconstruction_of(sequence, &counts);
                progress(sequence + 1, all.len());
                errors
            };
            all.iter().map(measure).collect::<Result<Vec<_>, _>>()
        })?;

        files::create_dir(&self.out)?;
        let layer = unposed.layer(&regression.trained_model, learning.features);
        layer.save(self.out.join("layer.npz"))?;
        associate::draw(&tied, &self.out)?;
        let rows = set.sequences.iter().zip(table).map(|(sequence, errors)| Row {
            sequence: sequence.name.clone(),
            frames: sequence.frames(),
            errors: errors.into_iter().map(Errors::from).collect(),
        });
        let report = Report {
            clothing_vertices: association.clothing_vertices(),
            pairs: association.pairs,
            completed_vertices: association.completion.total(),
            components,
            explained: regression.trained_model.pca.explained(),
            reconstruction: rows.collect(),
            counts,
            train: regression.train.into(),
            predict: regression.predict.into(),
            out: self.out,
        };
        write_json(&report.out.join("layer.json"), &report)?;
        console.result(&report, || report.text())
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
