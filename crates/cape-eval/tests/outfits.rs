//! A run with six outfits, from raw captures to evaluation.

use std::{collections::BTreeMap, fs, ops::ControlFlow, path::Path};

use burn::tensor::Device;
use cape_core::{Outfit, OutfitVocabulary, npy::write_npy, silent};
use cape_data::{
    DisplacementStatistics, PackOptions, PackReport, PackedSet, SequenceList, Split, SplitSpec,
    pack,
    raw::{self, RawFrame},
};
use cape_eval::{EvalOptions, evaluate, quality};
use cape_infer::{
    BodySpec, Run, RunConfig, TrainConfig,
    prior::{DensityKind, LatentCodes, Prior},
};
use cape_model::CapeConfig;
use cape_stats::density::MixtureOptions;
use cape_synth::synthetic_body;
use cape_train::{Trainer, TrainerOptions};
use ndarray::Array2;

/// Directories of the captures; `poloshort` is packed as `shortshort`.
const WORN: [&str; 7] =
    ["blazerlong", "shortlong", "shortshort", "longshort", "longlong", "jerseyshort", "poloshort"];

fn outfit(name: &str) -> Outfit {
    name.parse().unwrap()
}

fn split() -> SplitSpec {
    let list = |name: &str| SequenceList { sequences: vec![name.to_owned()], exclude: Vec::new() };
    SplitSpec {
        subjects: vec!["ann".into()],
        outfits: WORN.map(outfit).to_vec(),
        labels: [(outfit("poloshort"), Outfit::SHORT_SHORT)].into(),
        cut: 0,
        train: list("walk"),
        test: list("hips"),
        ..SplitSpec::default()
    }
}

/// Raw captures whose displacement tells the outfit, with the body, packed by `split`.
fn packed(root: &Path, split: &SplitSpec) -> PackReport {
    let body = synthetic_body();
    fs::create_dir_all(root.join("raw")).unwrap();
    body.save(root.join("raw/body.npz")).unwrap();
    raw::write_minimal(root.join("raw"), "ann", &body.v_template).unwrap();
    for (place, name) in WORN.into_iter().enumerate() {
        for (sequence, frames) in [("walk", 4), ("hips", 2)] {
            for number in 0..frames {
                let offset = Array2::from_shape_fn(body.v_template.dim(), |(vertex, axis)| {
                    let wave = ((vertex + axis + number) as f64 * 0.5).sin();
                    0.002 * wave + 0.004 * place as f64
                });
                let v_cano = &body.v_template + &offset;
                let pose = std::array::from_fn(|i| 0.1 * ((i + number) as f64).sin());
                let frame = RawFrame { v_posed: v_cano.clone(), v_cano, pose, transl: [0.0; 3] };
                raw::write_frame(root.join("raw"), "ann", outfit(name), sequence, number, &frame)
                    .unwrap();
            }
        }
    }
    pack(root.join("raw"), root.join("packed"), split, PackOptions::default(), &mut silent).unwrap()
}

fn config() -> RunConfig {
    RunConfig {
        model: CapeConfig { filters: vec![4, 8], factors: vec![1, 2], ..CapeConfig::tiny() },
        train: TrainConfig { epochs: 1, batch: 4, warmup_epochs: 1.0, ..TrainConfig::default() },
        ..RunConfig::default()
    }
}

fn train(run: &Path, data: &Path, config: RunConfig) -> Run {
    let options = TrainerOptions::new(data, config);
    let mut trainer = Trainer::create(run, options, &Device::default()).unwrap();
    trainer.run(&mut |_| ControlFlow::Continue(())).unwrap();
    Run::open(run, &Device::default()).unwrap()
}

#[test]
fn six_outfits_from_captures_to_evaluation() {
    let directory = tempfile::tempdir().unwrap();
    let root = directory.path();
    let report = packed(root, &split());
    assert_eq!((report.train_frames, report.test_frames), (28, 14));
    assert_eq!(report.missing_outfits, []);
    let data = root.join("packed");
    let names = "blazerlong, shortlong, shortshort, longshort, longlong, jerseyshort";

    // Labels are one-hot in the order of the split; captures keep the names of their directories.
    let set = PackedSet::open(&data, Split::Train).unwrap();
    assert_eq!(set.vocabulary().to_string(), names);
    let last = set.frames() - 1;
    assert_eq!(set.outfits()[last], Outfit::SHORT_SHORT);
    assert_eq!(set.capture(last).as_deref(), Some("ann/poloshort_walk"));
    let batch = set.batch(&[0, last], None).unwrap();
    assert_eq!(batch.outfit.row(0).to_vec(), [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    assert_eq!(batch.outfit.row(1).to_vec(), [0.0, 0.0, 1.0, 0.0, 0.0, 0.0]);

    let run = train(&root.join("run"), &data, config());
    assert_eq!(run.outfits(), set.vocabulary());
    let text = fs::read_to_string(run.paths().unwrap().config()).unwrap();
    assert!(text.contains("\"blazerlong\"") && text.contains("\"jerseyshort\""), "{text}");

    // Every outfit is sampled; others are refused with the list.
    let pose = [0.0; 72];
    let wearer = |outfit| BodySpec { betas: Vec::new(), pose, outfit };
    let bodies: Vec<BodySpec> = run.outfits().iter().map(|&outfit| wearer(outfit)).collect();
    assert_eq!(run.dress(&run.sample_codes(6, 1), &bodies).unwrap().len(), 6);
    let message =
        run.dress(&run.sample_codes(1, 1), &[wearer(outfit("poloshort"))]).unwrap_err().to_string();
    let expected = format!("unknown outfit `poloshort`: expected one of {names}");
    assert!(message.contains(&expected), "{message}");
    assert_eq!(run.default_outfit(), Outfit::LONG_LONG);

    // Densities by outfit come back from their file.
    let codes = LatentCodes::from_training(&run, &data, 100, &mut silent).unwrap();
    let prior =
        Prior::fit(&codes, DensityKind::Mixture(1), true, &MixtureOptions::default()).unwrap();
    let path = root.join("prior.npz");
    prior.save(&path).unwrap();
    let loaded = Prior::load(&path).unwrap();
    assert_eq!(loaded.groups().count(), 6);
    let jersey = outfit("jerseyshort");
    assert_eq!(loaded.sample(jersey, 3, 1.0, 5), prior.sample(jersey, 3, 1.0, 5));
    assert_eq!(prior.sample_each(run.outfits(), 1.0, 5).unwrap().nrows(), 6);

    let evaluation = evaluate(&run, &data, EvalOptions::default(), &mut silent).unwrap();
    let worn: Vec<&str> = evaluation.model.outfits.keys().map(Outfit::name).collect();
    // The paper's four come first.
    let sorted = ["shortlong", "shortshort", "longshort", "longlong", "blazerlong", "jerseyshort"];
    assert_eq!(worn, sorted);
    let options = quality::QualityOptions { frames: 14, each: 2, ..Default::default() };
    let codes = quality::standard_normal(run.latent(), 1.0, 1);
    let report = quality::quality(&run, &data, &codes, options, &mut silent).unwrap();
    assert_eq!(report.diversity_mm.len(), 6);
}

#[test]
fn sets_take_the_outfits_of_a_model() {
    let directory = tempfile::tempdir().unwrap();
    let root = directory.path();
    let only = |names: &[&str]| SplitSpec {
        outfits: names.iter().map(|name| outfit(name)).collect(),
        labels: BTreeMap::new(),
        ..split()
    };
    packed(root, &only(&["longlong", "jerseyshort", "shortlong"]));
    let data = root.join("packed");
    let open = || PackedSet::open(&data, Split::Test).unwrap();
    let vocabulary =
        |names: &[&str]| OutfitVocabulary::new(names.iter().map(|name| outfit(name))).unwrap();
    let given = vocabulary(&["shortlong", "longlong", "coat", "jerseyshort"]);
    let set = open().with_vocabulary(&given).unwrap();
    assert_eq!(set.outfits()[0], Outfit::LONG_LONG);
    assert_eq!(set.batch(&[0], None).unwrap().outfit.row(0).to_vec(), [0.0, 1.0, 0.0, 0.0]);
    let message = open().with_vocabulary(&OutfitVocabulary::default()).unwrap_err().to_string();
    assert!(message.contains("frames in `jerseyshort`") && message.contains("shortlong, "));

    // A configuration can name more outfits than the data have, or give another order.
    let mut named = config();
    named.model.outfits = given.clone();
    let run = train(&root.join("run"), &data, named);
    assert_eq!(run.outfits(), &given);
    assert_eq!(run.open_set(&data, Split::Test).unwrap().vocabulary(), &given);
    assert!(run.expect_set(&open()).is_err());

    // Without a split file, outfits are known by their place until a model names them.
    fs::remove_file(data.join("split.toml")).unwrap();
    assert_eq!(open().vocabulary().to_string(), "outfit1, outfit2, outfit3");
    assert!(!open().names_outfits());
    let three = vocabulary(&["longlong", "jerseyshort", "shortlong"]);
    assert_eq!(open().with_vocabulary(&three).unwrap().outfits()[2], outfit("jerseyshort"));
    assert!(open().with_vocabulary(&given).is_err(), "another number of outfits");
}

#[test]
fn four_outfits_are_the_papers() {
    let directory = tempfile::tempdir().unwrap();
    let root = directory.path();
    let four = SplitSpec {
        outfits: vec![Outfit::LONG_LONG, outfit("poloshort"), Outfit::SHORT_LONG],
        ..split()
    };
    packed(root, &four);
    let data = root.join("packed");
    let run = train(&root.join("run"), &data, config());
    assert!(run.outfits().is_paper());
    // The configuration is as it was before there were other outfits.
    let text = fs::read_to_string(run.paths().unwrap().config()).unwrap();
    assert!(!text.contains("outfits"), "{text}");
    let set = PackedSet::open(&data, Split::Train).unwrap();
    assert_eq!(set.batch(&[0], None).unwrap().outfit.row(0).to_vec(), [0.0, 0.0, 0.0, 1.0]);

    // Labels of any kind of number, and other columns than the split has.
    let labels = cape_core::npy::read_i64(data.join("train/train_clo_label.npy")).unwrap();
    write_npy(data.join("train/train_clo_label.npy"), &labels.mapv(|x| x as u8)).unwrap();
    assert_eq!(PackedSet::open(&data, Split::Train).unwrap().outfits(), set.outfits());
    let wide = Array2::<u8>::from_shape_fn((set.frames(), 5), |(_, place)| u8::from(place == 0));
    write_npy(data.join("train/train_clo_label.npy"), &wide).unwrap();
    let message = PackedSet::open(&data, Split::Train).unwrap_err().to_string();
    assert!(message.contains("5 columns") && message.contains("4 outfits"), "{message}");
    // The statistics do not depend on labels.
    DisplacementStatistics::from_packed(&data, &mut silent).unwrap();
}
