//! Simulated clothing.

use cape::data::{PackOptions, SplitSpec, pack};

use crate::support::{Packed, contents};

const SMALL: &str = "data synth --clothes simulated --subjects 1 --outfits shortshort --motions simple \
                     --frames-per-sequence 1 --resolution 50";

#[test]
fn simulated_captures_are_written_packed_and_resumed() {
    let data = Packed::new();
    let report = data.run(&format!("{SMALL} --out @/simulated --json")).json();
    assert_eq!((report["takes"].as_u64(), report["frames"].as_u64()), (Some(1), Some(1)));
    let root = data.at("simulated");
    let split = SplitSpec { cut: 0, ..SplitSpec::from_file(root.join("split_male.toml")).unwrap() };
    assert_eq!(split.train.sequences, ["simple"]);
    pack(&root, data.at("simulated-packed"), &split, PackOptions::default(), &mut |_, _| {})
        .unwrap();
    let before = contents(&root);
    data.run(&format!("{SMALL} --out @/simulated")).succeeded();
    assert_eq!(contents(&root), before);
    data.run(&format!("{SMALL} --takes 2 --out @/simulated"))
        .failed_saying(&["simulated", "other settings"]);
    for body in ["female", "neutral"] {
        data.run(&format!("{SMALL} --body {body} --out @/simulated"))
            .failed_saying(&["simulated", "other settings or bodies"]);
    }
}

#[test]
fn options_of_simulated_clothing_need_it() {
    let data = Packed::new();
    data.run("data synth --takes 2 --out @/none").failed_saying(&["--takes", "simulated"]);
    data.run(&format!("{SMALL} --shard 3/2 --out @/none")).misused(&["I from 1 to N"]);
    let estimate = data.run(&format!("{SMALL} --dry-run --out @/none --json")).json();
    assert_eq!(estimate["takes"].as_u64(), Some(1));
    assert!(!data.at("none").exists());
}
