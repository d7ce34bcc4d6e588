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
};
use crate::{
    body_source::BodyModelArgs,
    console::Console,
    error::Result,
    files,
    options::{GlobalArgs, OutputArgs},
    table::Table,
};

/// Learn principal components and regression of clothing.
///
/// Writes layer.npz for `cape layer predict`, layer.json with reconstruction errors by number of
/// components and regression errors (tables 1 and 2 of the paper), and the association as coloured meshes
/// and a picture.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  cape layer learn skirt --components 40 --out learned")]
pub(crate) struct LearnArgs {
    /// Set of sequences written by `cape layer synth` or `cape layer import`.
    #[arg(value_name = "SET")]
    set: PathBuf,
    #[command(flatten)]
    output: OutputArgs,
    #[command(flatten)]
    body: BodyModelArgs,
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
    /// Errors with 1, 5, as many as are predicted, and all components.
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
        self.output.require_empty()?;
        let out = self.output.out;
        let model = self.body.load()?;
        let set = LayerSet::load_for(&self.set, &model)?;
        let learning = self.learning_args.learning(global.seed(), 1);
        let tied = self.association_args.associate(&model, &set, console)?;
        let association = &tied.association;
        let unposed =
            UnposedSet::new(&model, &set, association, &self.association_args.standard())?;
        let all: Vec<usize> = (0..set.sequences.len()).collect();
        let regression = console.while_showing("learn", "iterations", |progress| {
            let most = learning.training.minimiser.steps;
            unposed.regression(&all, &learning, &mut |_, epoch| progress(epoch.iteration, most))
        })?;
        let components = regression.trained_model.pca.latent();
        let mut counts = vec![1, 5, components];
        counts.sort_unstable();
        counts.dedup();
        let table = console.while_showing("measure", "sequences", |progress| {
            let measure = |&sequence: &usize| {
                let errors = unposed.reconstruction_of(sequence, &counts);
                progress(sequence + 1, all.len());
                errors
            };
            all.iter().map(measure).collect::<Result<Vec<_>, _>>()
        })?;

        files::create_dir(&out)?;
        let layer = unposed.layer(&regression.trained_model, learning.features);
        layer.save(out.join("layer.npz"))?;
        associate::draw(&tied, &out)?;
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
            out,
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
            "{}\n\nmean reconstruction error, mm\n\n{} clothing vertices associated by {} pairs, {} \
             completed\n{} components explain {:.1} % of the variance\nregression error: {:.2} mm on \
             training frames, {:.2} mm on held-out frames\n{}",
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
