use serde_json::json;

use super::*;

const EARLIER: &[&str] = &["key.txt", "frames/*.json", "run/"];

fn settings(noise: f64) -> StoreSettings {
    StoreSettings::new("fits", &json!({ "noise": noise })).unwrap()
}

fn open(root: &Path, noise: f64, overwrite: bool) -> Result<ResultStore> {
    let options = StoreOptions { overwrite, earlier: EARLIER, beside: &["rows"] };
    ResultStore::open(root, settings(noise), options)
}

fn refusal(root: &Path, noise: f64, overwrite: bool) -> String {
    open(root, noise, overwrite).unwrap_err().to_string()
}

fn files(root: &Path) -> Vec<String> {
    names(root).unwrap()
}

#[test]
fn items_are_kept_and_those_of_other_settings_refused() {
    let place = tempfile::tempdir().unwrap();
    let root = place.path().join("out");
    let store = open(&root, 0.1, false).unwrap();
    assert!(!root.exists(), "opening writes nothing");
    assert_eq!(store.read::<Vec<f64>>("frames/1.json").unwrap(), None);
    let written = store.write("frames/1.json", &vec![0.1 + 0.2]).unwrap();
    let again = open(&root, 0.1, false).unwrap();
    assert_eq!(again.read("frames/1.json").unwrap(), Some(written));
    assert!(again.owns("frames/1.json"));

    let message = refusal(&root, 0.2, false);
    for part in ["settings.json", "`settings.noise`", "0.1", "0.2", "--overwrite", "--out"] {
        assert!(message.contains(part), "{message}");
    }
    let other = StoreSettings::new("tables", &json!({ "noise": 0.1 })).unwrap();
    let overwrite = StoreOptions { overwrite: true, ..StoreOptions::default() };
    let message = ResultStore::open(&root, other, overwrite).unwrap_err().to_string();
    assert!(message.contains("`kind`") && message.contains("fits"), "{message}");
}

#[test]
fn overwriting_removes_what_was_listed_and_nothing_else() {
    let place = tempfile::tempdir().unwrap();
    let root = place.path();
    let store = open(root, 0.1, false).unwrap();
    store.write("frames/1.json", &1).unwrap();
    fs::write(store.claim("run/").unwrap().join("weights"), "w").unwrap();
    fs::write(root.join("frames/notes.txt"), "mine").unwrap();
    fs::write(root.join("notes.txt"), "mine").unwrap();
    // Matching results are kept, also to overwrite.
    assert_eq!(open(root, 0.1, true).unwrap().read("frames/1.json").unwrap(), Some(1));
    let other = open(root, 0.2, true).unwrap();
    assert_eq!(other.read::<i32>("frames/1.json").unwrap(), None);
    assert!(root.join("frames/1.json").exists(), "opening removes nothing");
    other.begin().unwrap();
    assert_eq!(files(root), ["files.txt", "frames", "notes.txt", "settings.json"]);
    assert_eq!(files(&root.join("frames")), ["notes.txt"]);
    let message = other.write("notes.txt", &1).unwrap_err().to_string();
    assert!(message.contains("notes.txt") && message.contains("move it"), "{message}");
    assert!(other.discard("notes.txt").is_err());
    other.write("frames/2.json", &2).unwrap();
    other.discard("frames/2.json").unwrap();
    assert_eq!(other.read::<i32>("frames/2.json").unwrap(), None);
    assert!(refusal(root, 0.1, false).contains("`settings.noise`"));
}

#[test]
fn an_item_that_cannot_be_read_is_named() {
    let place = tempfile::tempdir().unwrap();
    let store = open(place.path(), 0.1, false).unwrap();
    store.write("frames/1.json", &vec![1, 2, 3]).unwrap();
    fs::write(place.path().join("frames/1.json"), "[1, 2").unwrap();
    let message = store.read::<Vec<i32>>("frames/1.json").unwrap_err().to_string();
    assert!(message.contains("frames/1.json") && message.contains("remove this file"));
}

#[test]
fn directories_of_others_are_refused() {
    let place = tempfile::tempdir().unwrap();
    let root = place.path();
    fs::create_dir(root.join("rows")).unwrap();
    open(root, 0.1, false).unwrap();
    fs::write(root.join("thesis.tex"), "").unwrap();
    for overwrite in [false, true] {
        let message = refusal(root, 0.1, overwrite);
        assert!(message.contains("thesis.tex") && message.contains("--out"), "{message}");
    }
    // A settings.json of another program is not overwritten either.
    fs::write(root.join(SETTINGS), "{\"theme\": \"dark\"}").unwrap();
    for overwrite in [false, true] {
        let message = refusal(root, 0.1, overwrite);
        assert!(message.contains("settings.json") && !message.contains("--overwrite"));
    }
    assert!(refusal(&root.join("thesis.tex"), 0.1, false).contains("is a file"));
}

#[test]
fn directories_of_earlier_versions_are_told() {
    let place = tempfile::tempdir().unwrap();
    let root = place.path();
    for name in ["frames/1.json", "frames/1.png", "run/a/b", "key.txt", "mine.txt"] {
        create_dir(root.join(name).parent().unwrap()).unwrap();
        fs::write(root.join(name), "").unwrap();
    }
    let message = refusal(root, 0.1, false);
    for part in ["key.txt", "settings.json", "earlier version", "--overwrite"] {
        assert!(message.contains(part), "{message}");
    }
    open(root, 0.1, true).unwrap().begin().unwrap();
    assert_eq!(files(root), ["files.txt", "frames", "mine.txt", "settings.json"]);
    assert_eq!(files(&root.join("frames")), ["1.png"]);
    // Settings that lack the inputs.
    let options = |overwrite| StoreOptions { overwrite, earlier: &[SETTINGS], beside: &[] };
    fs::write(root.join(SETTINGS), "{\"version\": \"0.1.0\", \"options\": {}}").unwrap();
    let open = |overwrite| ResultStore::open(root, settings(0.1), options(overwrite));
    let message = open(false).unwrap_err().to_string();
    assert!(message.contains("`inputs`") && message.contains("--overwrite"), "{message}");
    open(true).unwrap().begin().unwrap();
    open(false).unwrap();
}

#[test]
fn a_list_that_leads_out_is_refused() {
    let place = tempfile::tempdir().unwrap();
    let root = place.path().join("out");
    open(&root, 0.1, false).unwrap().begin().unwrap();
    fs::write(place.path().join("precious"), "").unwrap();
    for line in ["../precious", "/etc", "a/../../precious"] {
        fs::write(root.join(FILES), format!("{line}\n")).unwrap();
        let message = refusal(&root, 0.2, true);
        assert!(message.contains("files.txt") && message.contains("line 1"), "{message}");
    }
    assert!(
        open(&tempfile::tempdir().unwrap().path().join("x"), 0.1, false)
            .unwrap()
            .claim("../precious")
            .is_err()
    );
    assert!(place.path().join("precious").exists());
}

#[test]
fn of_two_stores_of_other_settings_the_second_to_begin_is_refused() {
    let place = tempfile::tempdir().unwrap();
    let [one, other] = [0.1, 0.2].map(|noise| open(place.path(), noise, false).unwrap());
    one.write("frames/1.json", &1).unwrap();
    let message = other.write("frames/1.json", &2).unwrap_err().to_string();
    assert!(message.contains("`settings.noise`"), "{message}");
    assert_eq!(one.read("frames/1.json").unwrap(), Some(1));
}

#[test]
fn stores_of_the_same_settings_share_one_list() {
    for _ in 0..20 {
        let place = tempfile::tempdir().unwrap();
        let root = place.path().join("out");
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    let store = open(&root, 0.1, false).unwrap();
                    for item in 0..10 {
                        store.list(&format!("frames/{item}.json")).unwrap();
                    }
                });
            }
        });
        let text = fs::read_to_string(root.join(FILES)).unwrap();
        let mut lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 10, "{text}");
        lines.sort_unstable();
        lines.dedup();
        assert_eq!(lines.len(), 10, "{text}");
    }
}
