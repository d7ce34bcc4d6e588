use std::path::PathBuf;

use cape_layer::{Clearance, InsideShares, LayerSet, PredictedFrame, Sequence};
use clap::Args;
use ndarray::Axis;
use serde::Serialize;

use super::{
    association::AssociationArgs,
    clearance::{ClearanceArgs, InsideSum, inside_text},
    pictures::mesh_of,
    predict::FrameSampler,
};
use crate::{
    body_source::BodyModelArgs,
    console::Console,
    error::{Error, Result},
    files,
    options::{FileKind, OutputArgs, ShapeArgs, kinds},
};

/// Put captured clothing on a body of another shape.
///
/// Takes the offsets of a sequence's clothing from its body to a body with other shape coefficients in the
/// same motion (figures 2 and 5 of the paper); nothing is learned. Writes a mesh per frame and
/// transferred.png with some of them.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  cape layer transfer skirt --betas 2,-1 --out transferred")]
pub(crate) struct TransferArgs {
    /// Set of sequences written by `cape layer synth` or `cape layer import`.
    #[arg(value_name = "SET")]
    set: PathBuf,
    #[command(flatten)]
    output: OutputArgs,
    #[command(flatten)]
    body: BodyModelArgs,
    /// Sequence [default: the first].
    #[arg(long, value_name = "NAME")]
    sequence: Option<String>,
    #[command(flatten)]
    shape: ShapeArgs,
    #[command(flatten)]
    association_args: AssociationArgs,
    #[command(flatten)]
    clearance: ClearanceArgs,
    /// File format.
    #[arg(long, default_value = "ply", value_name = "FORMAT", value_parser = kinds([FileKind::Ply, FileKind::Obj]))]
    format: FileKind,
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    sequence: String,
    frames: usize,
    /// Shape coefficients of the new wearer.
    betas: Vec<f64>,
    /// Shares of the clothing's surface inside the body before and after it is pushed out, means over the
    /// frames, if it is.
    inside: Option<InsideShares>,
}

impl TransferArgs {
    pub(super) fn run(self, console: Console) -> Result {
        self.output.require_empty()?;
        let out = self.output.out.clone();
        let model = self.body.load()?;
        let set = LayerSet::load_for(&self.set, &model)?;
        let sequence = self.chosen(&set)?;
        let betas: Vec<f64> = match self.shape.given() {
            Some(_) => self.shape.betas(&model)?.into_iter().map(f64::from).collect(),
            None => sequence.betas.clone(),
        };
        let association = self.association_args.associate(&model, &set, console)?.association;
        let standard = self.association_args.standard();
        let wearer = Sequence { betas: betas.clone(), ..sequence.clone() };
        let distance = self.clearance.distance();
        let clearance = distance.map(|d| Clearance::new(d, &model, &set.faces, set.vertices()));
        let frames = sequence.frames();
        let mut inside = InsideSum::default();
        let mut gallery = FrameSampler::default();
        files::create_dir(&out)?;
        console.while_showing("transfer", "frames", |progress| {
            for frame in 0..frames {
                let captured = sequence.clothing.index_axis(Axis(0), frame);
                let from = sequence.body(&model, frame, &standard)?;
                let body = wearer.body(&model, frame, &standard)?;
                let mut clothing = association.transfer(&from, captured, &body)?;
                if let Some(clearance) = &clearance {
                    let (pushed, shares) = clearance.apply(body.posed.clone(), clothing.view());
                    clothing = pushed;
                    inside.push(shares);
                }
                let worn = PredictedFrame { frame, body, clothing, inside: None };
                let mesh = mesh_of(worn.clothing.view(), &set.faces);
                mesh.save(out.join(format!("frame-{frame:05}.{}", self.format.name())))?;
                gallery.push(&worn, mesh, &model.faces);
                progress(frame + 1, frames);
            }
            Ok::<_, Error>(())
        })?;
        let picture = out.join("transferred.png");
        gallery.save(&picture)?;
        let inside = inside.means();
        let report = Report { out, sequence: sequence.name.clone(), frames, betas, inside };
        console.result(&report, || {
            format!("{frames} frames\n{}{}", inside_text(inside), picture.display())
        })
    }

    fn chosen<'a>(&self, set: &'a LayerSet) -> Result<&'a Sequence> {
        let Some(name) = &self.sequence else {
            return set.sequences.first().ok_or_else(|| Error::message("the set has no sequences"));
        };
        set.sequences.iter().find(|sequence| sequence.name == *name).ok_or_else(|| {
            let known: Vec<&str> = set.sequences.iter().map(|s| s.name.as_str()).collect();
            Error::message(format!("--sequence `{name}`: the set has {}", known.join(", ")))
        })
    }
}
