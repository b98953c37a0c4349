//! What a package installs beside the program: manual pages, completions, an example of the settings.

use std::process::Command;

#[path = "oracle/program.rs"]
mod program;

use program::union3d;

#[test]
fn every_command_has_a_page_of_the_manual() {
    let directory = tempfile::tempdir().unwrap();
    let pages = directory.path().join("man");
    let output = union3d(&["man", pages.to_str().unwrap()], "");
    assert!(output.status.success() && output.stdout.is_empty());
    let page = |name: &str| std::fs::read_to_string(pages.join(name)).unwrap();
    assert!(page("union3d.1").contains("union3d\\-mill(1)"));
    assert!(page("union3d-serve.1").contains("\\-\\-queue\\-changes\\-max"));
    for name in [
        "mill", "path", "measure", "audit", "backup", "restore", "key", "demo",
    ] {
        assert!(
            page(&format!("union3d-{name}.1")).starts_with(".ie"),
            "{name}"
        );
    }
    // A place where no directory can be is refused by its name.
    let file = directory.path().join("file");
    std::fs::write(&file, "").unwrap();
    let output = union3d(&["man", file.to_str().unwrap()], "");
    assert!(!output.status.success());
    let errors = String::from_utf8(output.stderr).unwrap();
    assert!(errors.contains(file.to_str().unwrap()), "{errors}");
}

#[test]
fn shells_are_told_what_completes_a_command() {
    for (shell, words) in [
        ("bash", "complete -F _union3d"),
        ("zsh", "#compdef union3d"),
        ("fish", "complete -c union3d"),
    ] {
        let output = union3d(&["completions", shell], "");
        assert!(output.status.success());
        let text = String::from_utf8(output.stdout).unwrap();
        assert!(
            text.contains(words) && text.contains("fail-on-collision"),
            "{shell}"
        );
        if shell == "bash" {
            let read = Command::new("bash")
                .args(["-n", "-c", &text])
                .output()
                .unwrap();
            assert!(read.status.success(), "{read:?}");
        }
    }
}

#[test]
fn the_settings_are_printed_with_their_defaults() {
    let output = union3d(&["config"], "");
    assert!(output.status.success());
    let text = String::from_utf8(output.stdout).unwrap();
    assert_eq!(text, union3d::config::example());
    assert!(text.contains("\n#queue_changes_max = 1024\n"), "{text}");
}
