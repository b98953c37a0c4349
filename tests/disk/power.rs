//! The power fails after every single call of a workload that writes.

use std::collections::BTreeMap;
use std::path::Path;

use union3d::geometry::Totals;
use union3d::service::Offline;

use super::Random;
use super::disk::{Disk, Event, temporary};
use super::image::{Image, Reached};
use super::workload::{Client, Story, World, data};

fn record(seed: u64) -> (Vec<Event>, Story) {
    let disk = Disk::new();
    let mut client = Client::new(&disk, seed);
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .unwrap();
    runtime.block_on(client.everything());
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

#[test]
fn nothing_acknowledged_is_lost_by_a_power_cut_after_any_call() {
    let seed = 1;
    println!("seed {seed}");
    let (events, story) = record(seed);
    let mut random = Random::new(seed);
    let mut image = Image::new();
    let mut mark = 0;
    let mut failures = Vec::new();
    let mut cuts = 0;
    for (index, event) in events.iter().enumerate() {
        image.apply(event, &mut random);
        if let Event::Mark(next) = event {
            mark = *next;
        }
        let known = &story.worlds[mark];
        let next = story.worlds.get(mark + 1).unwrap_or(known);
        for reached in [
            Reached::None,
            Reached::All,
            Reached::Some(random.next()),
            Reached::Some(random.next()),
        ] {
            let root = temporary();
            image.write_to(root.path(), reached);
            cuts += 1;
            let outcome =
                recover(root.path()).and_then(|found| compare(&found, &story, known, next));
            if let Err(what) = outcome {
                failures.push(format!(
                    "after call {index}, {reached:?}, {event:?}: {what}"
                ));
            }
        }
    }
    println!("{} calls, {cuts} cuts", events.len());
    assert!(
        failures.is_empty(),
        "{} of {cuts}:\n{}",
        failures.len(),
        failures[..failures.len().min(20)].join("\n")
    );
}
