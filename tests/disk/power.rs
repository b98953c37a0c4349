//! The power fails after every single call of a workload that writes.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use union3d::geometry::Totals;
use union3d::service::Offline;

use super::Random;
use super::disk::{Disk, Event, temporary};
use super::image::{Image, Reached};
use super::workload::{Client, Story, World, data};

/// The record of what `work` does to a disk.
pub(crate) fn record(
    disk: &Disk,
    seed: u64,
    work: impl AsyncFnOnce(&mut Client<'_>),
) -> (Vec<Event>, Story) {
    let mut client = Client::new(disk, seed);
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .unwrap();
    runtime.block_on(work(&mut client));
    (disk.events(), client.story)
}

/// Seq and totals of every scene, as found and as recounted.
fn recover(root: &Path) -> Result<BTreeMap<String, (u64, Totals)>, String> {
    if !data(root).join("scenes").exists() {
        return Ok(BTreeMap::new());
    }
    let offline = Offline::open(&data(root)).map_err(|error| error.to_string())?;
    let mut found = BTreeMap::new();
    for name in offline.scenes() {
        let audit = offline.audit(name, &mut |_| ());
        let audit = audit.map_err(|error| format!("{}: {error}", name.as_str()))?;
        if let Some(lost) = audit.notices.iter().find(|notice| notice.contains("lost")) {
            return Err(lost.clone());
        }
        let audit = audit.audit;
        if audit.kept != audit.recounted {
            return Err(format!("{}: differs from a recount", name.as_str()));
        }
        found.insert(name.as_str().to_owned(), (audit.seq.0, audit.kept));
    }
    Ok(found)
}

/// Whether what was found is what was acknowledged, or on its way to `next`.
fn compare(
    found: &BTreeMap<String, (u64, Totals)>,
    story: &Story,
    known: &World,
    next: &World,
) -> Result<(), String> {
    for name in known.keys().chain(next.keys()).chain(found.keys()) {
        let ends = [known.get(name), next.get(name)];
        let fits = match found.get(name) {
            None => ends.contains(&None),
            Some((seq, totals)) => {
                let is = |life: u32| story.totals.get(&(name.clone(), life, *seq)) == Some(totals);
                match ends {
                    [Some(from), Some(to)] if from.life == to.life => {
                        (from.seq..=to.seq).contains(seq) && is(from.life)
                    }
                    [Some(only), None] | [None, Some(only)] => *seq == only.seq && is(only.life),
                    _ => false,
                }
            }
        };
        if !fits {
            return Err(format!(
                "{name}: found seq {:?}, known is {:?}, on its way {:?}",
                found.get(name).map(|(seq, _)| seq),
                ends[0],
                ends[1]
            ));
        }
    }
    Ok(())
}

/// What a power cut leaves, recovered and compared.
fn cut(
    image: &Image,
    reached: Reached,
    story: &Story,
    known: &World,
    next: &World,
) -> Result<(), String> {
    let root = temporary();
    image.write_to(root.path(), reached);
    recover(root.path()).and_then(|found| compare(&found, story, known, next))
}

/// The failures of cuts after those events that `wanted` picks, in `ways` different ways each.
pub(crate) fn cut_all(
    events: &[Event],
    story: &Story,
    random: &mut Random,
    ways: usize,
    wanted: impl Fn(&Event) -> bool,
) -> Vec<String> {
    let mut image = Image::new();
    let mut mark = 0;
    let mut failures = Vec::new();
    for (index, event) in events.iter().enumerate() {
        image.apply(event, random);
        if let Event::Mark(next) = event {
            mark = *next;
        }
        if !wanted(event) {
            continue;
        }
        let known = &story.worlds[mark];
        let next = story.worlds.get(mark + 1).unwrap_or(known);
        let some = std::iter::repeat_with(|| Reached::Some(random.next()));
        let reached = [Reached::None, Reached::All].into_iter().chain(some);
        for reached in reached.take(ways) {
            if let Err(what) = cut(&image, reached, story, known, next) {
                failures.push(format!(
                    "after call {index} ({event:?}), {reached:?} reached: {what}"
                ));
            }
        }
    }
    failures
}

#[track_caller]
pub(crate) fn assert_none(failures: &[String]) {
    let first = &failures[..failures.len().min(20)];
    assert!(
        failures.is_empty(),
        "{}:\n{}",
        failures.len(),
        first.join("\n")
    );
}

#[test]
fn nothing_acknowledged_is_lost_by_a_power_cut_after_any_call() {
    let seed = 1;
    println!("seed {seed}");
    let (events, story) = record(&Disk::new(), seed, async |client| client.everything().await);
    println!("{} calls", events.len());
    let failures = cut_all(&events, &story, &mut Random::new(seed), 4, |_| true);
    assert_none(&failures);
}

/// All files of a directory but SQLite's shared index, which is written through memory and made anew after a crash.
fn files(directory: &Path, to: &mut BTreeMap<PathBuf, Vec<u8>>) {
    for entry in fs::read_dir(directory).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files(&path, to);
        } else if path
            .extension()
            .is_none_or(|extension| extension != "sqlite-shm")
        {
            to.insert(path.clone(), fs::read(path).unwrap());
        }
    }
}

/// No call is missed: what is made of the record is what is there.
#[test]
fn the_record_holds_all_that_reaches_the_files() {
    let disk = Disk::new();
    let (events, _) = record(&disk, 2, async |client| client.everything().await);
    let mut random = Random::new(2);
    let mut image = Image::new();
    for event in &events {
        image.apply(event, &mut random);
    }
    let copy = temporary();
    image.write_to(copy.path(), Reached::All);
    let [there, recorded] = [disk.path(), copy.path()].map(|root| {
        let mut found = BTreeMap::new();
        files(root, &mut found);
        let found = found.into_iter();
        let found = found.map(|(path, bytes)| (path.strip_prefix(root).unwrap().to_owned(), bytes));
        found.collect::<BTreeMap<_, _>>()
    });
    assert!(there.len() > 4, "{:?}", there.keys());
    assert!(
        there.keys().eq(recorded.keys()),
        "{:?} {:?}",
        there.keys(),
        recorded.keys()
    );
    for (path, bytes) in there {
        assert!(bytes == recorded[&path], "{} differs", path.display());
    }
}
