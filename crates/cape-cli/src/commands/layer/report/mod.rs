//! All experiments on clothing layers, in one report.

mod cape;
mod figures;
mod jobs;
mod results;
mod sets;
mod tables;

use std::{fmt::Write as _, path::PathBuf};

use cape_cloth::GarmentKind;
use cape_core::SmplModel;
use cape_eval::store::{ResultStore, StoreOptions, StoreSettings};
use cape_infer::write_json;
use cape_layer::{
    LayerSet,
    experiment::{ComponentCurve, Experiment, ExperimentResults},
};
use cape_render::Image;
use clap::Args;

use super::{
    associate,
    association::{AssociationArgs, LearningArgs},
    synth::GARMENTS,
};
use crate::{
    body_source::{BodyModelArgs, BodySource},
    console::Console,
    error::{Context, Result},
    files,
    html::{self, HtmlFigure},
    options::{GlobalArgs, StoreArgs, at_least_one, choices, positive},
};
use cape::compare;
use jobs::{ExperimentContext, NamedSet};
use results::{OutputPaths, SetDescription};
use sets::{SetSize, simulated};
use tables::ReportTable;

/// Frames per sequence and edge length in millimetres, with --quick and without.
const QUICK: (usize, f64) = (16, 50.0);
const FULL: (usize, f64) = (110, 25.0);

/// Run the experiments of Yang et al. on sets of sequences.
///
/// For every set: reconstruction by number of components (table 1, figure 3), regression of held-out frames (table
/// 2), and prediction of left-out body shapes, motions, materials and sizes. Without sets, simulates its
/// own: a garment on two subjects in five motions, in eight fabrics, in eight sizes, and in 15 motions in
/// random styles. Writes report.html,
/// report.json, tables (.csv) and pictures (.png). Run the same command again to resume.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  cape layer report --quick --out quick-report\n  cape layer report \
                  skirts shirts --components 40 --cape runs/cape --out report"
)]
pub(crate) struct ReportArgs {
    /// Sets of sequences [default: simulated].
    #[arg(value_name = "SET")]
    sets: Vec<PathBuf>,
    #[command(flatten)]
    output: StoreArgs,
    /// Simulate few short sequences of a coarse garment.
    #[arg(long, conflicts_with = "sets")]
    quick: bool,
    /// Simulated garment.
    #[arg(long, default_value = "skirt", value_name = "GARMENT", value_parser = choices(GARMENTS), conflicts_with = "sets")]
    garment: GarmentKind,
    /// Frames per simulated sequence.
    #[arg(long, value_name = "N", value_parser = at_least_one, conflicts_with = "sets")]
    frames: Option<usize>,
    /// Edge length of the simulated garment's triangles, mm.
    #[arg(long, value_name = "MM", value_parser = positive, conflicts_with = "sets")]
    resolution: Option<f64>,
    /// Random styles of each of the 15 simulated motions of which some are left out.
    #[arg(long, default_value_t = 2, value_name = "N", value_parser = at_least_one, conflicts_with_all = ["sets", "quick"])]
    styles: usize,
    #[command(flatten)]
    body: BodyModelArgs,
    /// Run of CAPE to compare with on displacements of its test frames.
    #[arg(long, value_name = "RUN")]
    cape: Option<PathBuf>,
    /// Packed set of the comparison [default: the one that the run was trained on].
    #[arg(long, value_name = "DIR", requires = "cape")]
    data: Option<PathBuf>,
    #[command(flatten)]
    association_args: AssociationArgs,
    #[command(flatten)]
    learning_args: LearningArgs,
    /// Number of trainings with different seeds, over which errors are averaged [default: 5, with --quick
    /// 1].
    #[arg(long, value_name = "N", value_parser = at_least_one)]
    trainings: Option<usize>,
}

/// A picture with its title and caption.
struct FigureRow {
    name: String,
    title: String,
    caption: String,
    image: Image,
}

impl ReportArgs {
    pub(super) fn run(mut self, global: &GlobalArgs, console: Console) -> Result {
        let body = self.body.source()?;
        let model = body.load()?;
        let store = self.store()?;
        let results = store.path("results");
        if self.quick {
            // Experiments on new motions train on few frames.
            self.learning_args.components.get_or_insert(QUICK.0 / 2);
        }
        let trainings = self.trainings.unwrap_or(if self.quick { 1 } else { 5 });
        let learning = self.learning_args.learning(global.seed(), trainings);
        let sets = self.sets((&model, &body), console)?;
        let laboratory = ExperimentContext {
            model: &model,
            learning,
            association_args: self.association_args.clone(),
            body: &body,
            results: &results,
            overwrite: self.output.overwrite,
            console,
        };
        // All are checked before the first is computed.
        let stores = sets
            .iter()
            .map(|named| laboratory.store(named).doing(|| format!("set {}", named.name)))
            .collect::<Result<Vec<_>>>()?;
        let mut written = OutputPaths {
            out: self.output.out.clone(),
            sets: sets.iter().map(SetDescription::new).collect(),
            reconstruction: Vec::new(),
            regression: Vec::new(),
            curves: Vec::new(),
            comparison: None,
        };
        let mut shown = Vec::new();
        for (named, results) in sets.iter().zip(&stores) {
            let doing = || format!("set {}", named.name);
            shown.push(self.association(&model, named, results, console).doing(doing)?);
            for (job, outcome, image) in laboratory.work(named, results).doing(doing)? {
                let ExperimentResults { reconstructed, regressed, curves } = outcome;
                written.curves.extend(curves);
                written.reconstruction.extend(reconstructed);
                written.regression.extend(regressed);
                shown.push(FigureRow::new(named, job, image));
            }
        }
        if let Some(run) = &self.cape {
            let device = global.device()?;
            let (data, kept) =
                (self.data.as_deref(), (&*store.path("comparison"), self.output.overwrite));
            let found = compare(run, data, &laboratory.learning, kept, &device, console);
            written.comparison = Some(found.doing(|| "comparison with CAPE".into())?);
        }
        shown.insert(0, FigureRow::of_curves(&written.curves)?);
        let tables = written.tables();
        self.write(&store, &written, &tables, &shown)?;
        console.result(&written, || {
            let texts: Vec<String> = tables.iter().map(ReportTable::text).collect();
            format!("{}\n\n{}", texts.join("\n\n"), self.output.out.join("report.html").display())
        })
    }

    /// The directory of tables and pictures; every set has a store of its own inside it.
    fn store(&self) -> Result<ResultStore> {
        let options = StoreOptions {
            overwrite: self.output.overwrite,
            earlier: &[
                "report.html",
                "report.json",
                "reconstruction.csv",
                "regression.csv",
                "new.csv",
                "cape.csv",
                "results/*.json",
                "results/*.png",
            ],
            beside: &["sets", "results", "comparison"],
        };
        let settings = StoreSettings::new("layer report", &())?;
        let store = ResultStore::open(&self.output.out, settings, options)?;
        store.begin()?;
        Ok(store)
    }

    fn sets(&self, body: (&SmplModel, &BodySource), console: Console) -> Result<Vec<NamedSet>> {
        let mut named = Vec::new();
        if self.sets.is_empty() {
            let (frames, resolution) = if self.quick { QUICK } else { FULL };
            let size = SetSize {
                quick: self.quick,
                frames: self.frames.unwrap_or(frames),
                resolution: 1e-3 * self.resolution.unwrap_or(resolution),
                styles: self.styles as u64,
            };
            let out = self.output.out.join("sets");
            let designs = (size, self.garment);
            for (name, set) in simulated(body, &out, designs, self.output.overwrite, console)? {
                named.push(NamedSet { directory: out.join(&name), name, set });
            }
        }
        for (index, path) in self.sets.iter().enumerate() {
            let stem = path.file_name().map_or("set".into(), |name| name.to_string_lossy());
            let known = named.iter().any(|other: &NamedSet| other.name == stem);
            let name = if known { format!("{stem}-{index}") } else { stem.into_owned() };
            named.push(NamedSet {
                name,
                directory: path.clone(),
                set: LayerSet::load_for(path, body.0)?,
            });
        }
        Ok(named)
    }

    /// Draws the association of a set.
    fn association(
        &self,
        model: &SmplModel,
        named: &NamedSet,
        store: &ResultStore,
        console: Console,
    ) -> Result<FigureRow> {
        let tied = self.association_args.associate(model, &named.set, console)?;
        let directory = store.claim("association/")?;
        associate::draw(&tied, &directory)?;
        let statistics = &tied.association.statistics;
        Ok(FigureRow {
            name: format!("{}-association", named.name),
            title: format!("{}: association", named.name),
            caption: format!(
                "Clothing in the colours of its associated body vertices: {} clothing vertices, {} \
                 pairs from {} rays that hit the clothing, {} vertices completed.",
                tied.association.clothing_vertices(),
                tied.association.pairs,
                statistics.hits,
                tied.association.completion.total()
            ),
            image: Image::load(directory.join("association.png"))?,
        })
    }

    fn write(
        &self,
        store: &ResultStore,
        written: &OutputPaths,
        tables: &[ReportTable],
        shown: &[FigureRow],
    ) -> Result {
        write_json(&store.claim("report.json")?, written)?;
        let mut page = written.described();
        for table in tables {
            files::write_text(&store.claim(&format!("{}.csv", table.name))?, &table.csv())?;
            page += &table.html();
        }
        for FigureRow { name, title, caption, image } in shown {
            image.save(store.claim(&format!("{name}.png"))?)?;
            page += &HtmlFigure { title, caption, image }.html()?;
        }
        let settings = format!("{:#?}", (&self.association_args, &self.learning_args));
        let _ = writeln!(
            page,
            "<h2>Options</h2><p>cape {}</p><pre>{}</pre>",
            env!("CARGO_PKG_VERSION"),
            html::escaped(&settings)
        );
        let page = html::page("Clothing layers", "Statistics of clothing layers", &page);
        files::write_text(&store.claim("report.html")?, &page)
    }
}

impl FigureRow {
    fn new(named: &NamedSet, job: Experiment, image: Image) -> Self {
        let caption = match job {
            Experiment::Reconstruction => {
                "The middle frame of the first sequence and its reconstructions by the sequence's \
                 own components, coloured by error."
            }
            Experiment::Regression => {
                "Held-out frames of the first sequence and their predictions, coloured by error."
            }
            Experiment::Transfer(_) => {
                "Frames of a left-out value (the one of median error) and their predictions, \
                 coloured by error."
            }
        };
        let title = match job {
            Experiment::Transfer(factor) => format!("{}: new {}", named.name, factor.name()),
            job => format!("{}: {}", named.name, job.name()),
        };
        let name = format!("{}-{}", named.name, job.name());
        Self { name, title, caption: caption.into(), image }
    }
}

impl FigureRow {
    /// Errors by the number of components.
    fn of_curves(curves: &[ComponentCurve]) -> Result<Self> {
        Ok(Self {
            name: "components".into(),
            title: "Error by number of components (figure 3)".into(),
            caption:
                "Mean distance over the sequences of a set; held out is every fifth frame with the \
                      components of the others."
                    .into(),
            image: figures::curves(curves)?,
        })
    }
}
