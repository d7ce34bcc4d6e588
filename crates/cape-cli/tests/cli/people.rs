//! Data of male and female subjects, and bodies by name.

use std::fs;

use cape::{
    core::{SmplModel, smpl::Gender},
    data::{RawTree, SplitSpec},
    synth::embedded_body,
};

use crate::support::Packed;

const PEOPLE: &str =
    "data synth --subjects 3 --outfits longlong --motions squats,soccer --frames-per-sequence 6";

#[test]
fn subjects_are_male_and_female_in_turn() {
    let data = Packed::new();
    let said = data.run(&format!("{PEOPLE} --out @/people")).succeeded();
    assert!(said.contains("next: cape data pack") && said.contains("--preset male"), "{said}");
    let tree = RawTree::open(data.at("people")).unwrap();
    let genders: Vec<(String, String)> = tree.genders().unwrap().into_iter().collect();
    let expected = [("s0001", "male"), ("s0002", "female"), ("s0003", "male")];
    assert_eq!(genders, expected.map(|(name, gender)| (name.to_owned(), gender.to_owned())));
    for (gender, subjects) in
        [(Gender::Male, vec!["s0001", "s0003"]), (Gender::Female, vec!["s0002"])]
    {
        let split = data.at(&format!("people/split_{gender}.toml"));
        let split = SplitSpec::from_file(split).unwrap();
        assert_eq!(split.subjects, subjects);
        assert_eq!(split.body, Some(format!("body_{gender}.npz").into()));
        let body = SmplModel::load(data.at(&format!("people/body_{gender}.npz"))).unwrap();
        assert_eq!(body, embedded_body(gender).unwrap());
        // Minimal shapes are in the span of the body's own shape directions.
        for subject in subjects {
            let minimal = tree.minimal(subject, false).unwrap();
            assert!(body.fit_betas(&minimal, 10).unwrap().rms < 1e-9, "{subject}");
        }
    }
    assert!(!data.at("people/body.npz").exists() && !data.at("people/split.toml").exists());

    let facts = data.run("info @/people --json").json();
    assert_eq!(facts["male subjects"], serde_json::json!(["s0001", "s0003"]));
    assert_eq!(facts["female body"], "female (built in)");
    let inspected = data.run("data inspect @/people").succeeded();
    assert!(inspected.contains("female: s0002"), "{inspected}");
    assert!(inspected.contains("only one outfit"), "{inspected}");
    assert_eq!(inspected.matches("warning:").count(), 1, "{inspected}");

    data.run("data pack @/people --out @/none")
        .failed_saying(&["--preset male", "--preset female"]);
    let packed = data.run("data pack @/people --preset female --out @/female --json").json();
    assert_eq!((&packed["train_frames"], &packed["test_frames"]), (&2.into(), &2.into()));
    assert_eq!(data.run("info @/female --json").json()["body"], "female (built in)");

    // Each subject is unposed by its own body: nothing changes.
    data.run("data unpose @/people --out @/again").succeeded();
    for name in ["body_male.npz", "body_female.npz", "misc/subj_genders.pkl"] {
        let read = |tree: &str| fs::read(data.at(tree).join(name)).unwrap();
        assert_eq!(read("again"), read("people"), "{name}");
    }
    let read = |tree: &str| {
        let path = "sequences/s0002/longlong_squats/longlong_squats.000003.npz";
        cape::data::raw::read_frame(data.at(tree).join(path), None).unwrap().v_cano
    };
    let difference = read("again") - read("people");
    assert!(difference.iter().all(|x| x.abs() < 1e-6));
}

#[test]
fn one_body_for_all_and_one_subject_alone_need_no_preset() {
    let data = Packed::new();
    data.run(&format!("{PEOPLE} --body sculpted --out @/one")).succeeded();
    assert_eq!(data.run("info @/one --json").json()["body"], "sculpted (built in)");
    assert!(!data.at("one/misc").exists());
    let packed = data.run("data pack @/one --out @/one-packed --json").json();
    assert_eq!(packed["train_frames"], 6);
    data.run(&format!("{PEOPLE} --subjects 1 --out @/single").replace("--subjects 3 ", ""))
        .succeeded();
    data.run("data pack @/single --out @/single-packed").succeeded();
    assert_eq!(data.run("info @/single-packed --json").json()["body"], "male (built in)");
}

#[test]
fn directories_of_bodies_have_both_genders() {
    let data = Packed::new();
    fs::create_dir(data.at("models")).unwrap();
    for (gender, name) in [(Gender::Female, "SMPL_MALE"), (Gender::Male, "SMPL_FEMALE")] {
        embedded_body(gender)
            .unwrap()
            .save(data.at("models").join(name).with_extension("npz"))
            .unwrap();
    }
    // The bodies are exchanged.
    data.run(&format!("{PEOPLE} --body @/models --out @/people")).succeeded();
    let facts = data.run("info @/people --json").json();
    assert_eq!(
        (&facts["male body"], &facts["female body"]),
        (&"female (built in)".into(), &"male (built in)".into())
    );
    data.run(&format!("{PEOPLE} --body @/models --gender female --out @/one")).succeeded();
    assert_eq!(data.run("info @/one --json").json()["body"], "male (built in)");
    fs::remove_file(data.at("models/SMPL_FEMALE.npz")).unwrap();
    data.run(&format!("{PEOPLE} --body @/models --out @/none")).failed_saying(&["SMPL_FEMALE"]);
}

#[test]
fn training_and_table_2_take_built_in_bodies_and_name_them() {
    let data = Packed::new();
    data.run(&format!("{PEOPLE} --body male --out @/people")).succeeded();
    data.run("data pack @/people --out @/male").succeeded();
    let line = "table2 --data @/male --rows mean --out @/table";
    data.run(line).succeeded();
    let caption = fs::read_to_string(data.at("table/table2.md")).unwrap();
    assert!(caption.contains("Body: male (built in)."), "{caption}");
    let latex = fs::read_to_string(data.at("table/table2.tex")).unwrap();
    assert!(latex.starts_with("% Body: male (built in).\n"), "{latex}");
    let page = fs::read_to_string(data.at("table/report.html")).unwrap();
    assert!(page.contains("Body: male (built in)."));

    fs::remove_file(data.at("male/body.npz")).unwrap();
    let train = "train --data @/male --preset tiny --epochs 1 --quiet --out @/run";
    data.run(train).failed_saying(&["no body of its own", "--body"]);
    data.run(&format!("{train} --body male")).succeeded();
    assert_eq!(data.run("info @/run --json").json()["body"], "male (built in)");
    data.run("data inspect @/male --body neutral").succeeded();
    data.run("data inspect @/male --body child").failed_saying(&["child"]);
    data.run("train --data @/packed --body male --preset tiny --out @/none")
        .failed_saying(&["the given body has 6890 vertices"]);
    // Results with another body are refused.
    let json = data.run("table2 --data @/male --rows mean --body male --out @/given --json").json();
    assert_eq!(json["body"], "male (built in)");
    data.run("table2 --data @/male --rows mean --body female --out @/given")
        .failed_saying(&["inputs.body"]);
}
