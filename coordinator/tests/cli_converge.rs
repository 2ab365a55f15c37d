//! `converge`: a table, a CSV file and a plot of several methods; what it refuses.

mod common;

use common::{run, scene};

#[test]
fn methods_are_compared_with_a_reference_of_its_own_making() {
    let dir = tempfile::tempdir().unwrap();
    let room = scene("cornell-diffuse.glb");
    let args = format!("converge {} --width 12 --height 12 --methods path,mlt --time 0.3s -o e.csv", room.display());
    let run = run(dir.path(), &args);
    run.says(0, &["making a reference by path"]);
    let lines: Vec<&str> = run.out.lines().collect();
    assert!(lines[0].starts_with("reference: made by path; its own noise is"), "{run:?}");
    assert!(lines[2].starts_with("path ") && lines[3].starts_with("mlt "), "{run:?}");
    let csv = std::fs::read_to_string(dir.path().join("e.csv")).unwrap();
    // Errors fall, and time and samples grow.
    let of = |method: &str| -> Vec<[f64; 3]> {
        let rows = csv.lines().filter(|l| l.split(',').next() == Some(method));
        rows.map(|l| l.split(',').collect::<Vec<_>>()).map(|f| [1, 2, 5].map(|i| f[i].parse().unwrap())).collect()
    };
    for method in ["path", "mlt"] {
        let rows = of(method);
        assert!(rows.len() > 3 && rows.is_sorted_by(|a, b| a[0] < b[0] && a[1] < b[1]), "{csv}");
        assert!(rows[rows.len() - 1][2] < 0.5 * rows[0][2], "{csv}");
    }
    let page = std::fs::read_to_string(dir.path().join("e.html")).unwrap();
    assert!(page.matches("<svg").count() == 2 && page.contains("relMSE") && !page.contains("http"), "{page}");
}

#[test]
fn senseless_comparisons_are_refused_before_any_work() {
    let dir = tempfile::tempdir().unwrap();
    let room = scene("cornell-diffuse.glb");
    let converge = |more: &str| run(dir.path(), &format!("converge {} --width 8 {more}", room.display()));
    converge("--methods path,magic").says(2, &["--methods: \"magic\" is none of whitted, path"]);
    converge("--method path").says(2, &["name the methods by --methods"]);
    converge("--methods path -o errors.txt").says(2, &["errors.txt must end in .csv"]);
    converge("--methods path,vcm --samples 4").says(2, &["--samples", "vcm"]);
    converge("--methods path --reference none.exr").says(2, &["there is no file none.exr"]);
}
