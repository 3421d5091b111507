use mvcalib::loss::*;
use mvcalib::{labelme, problem, vehicle};
fn main() {
    let d = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("data");
    let (v, size) = labelme::read_vehicles(&d.join("k109f/labels")).unwrap();
    let models = vehicle::read_models(&d.join("vehicles.json")).unwrap();
    let p = problem::Problem::new(size, v, models).unwrap();
    for seed in [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 20, 21] {
        let mut s = mvcalib::stages::Settings::paper(320.0);
        s.weights = Weights { form: Form::Authors, alpha: 1.0, tau: 0.0 };
        s.seed = seed;
        if seed >= 20 {
            s.matching_budget = 200_000;
        }
        let t = std::time::Instant::now();
        let st = mvcalib::stages::calibrate(&p, &s, &|_| ()).unwrap();
        println!("seed {seed} {:?} f {}", t.elapsed(), st.camera(&p).lens.f);
        for v in 0..7 {
            let row: Vec<String> = st
                .refined
                .iter()
                .filter(|m| m.vehicle == v)
                .map(|m| {
                    format!(
                        "{}:{:.4}/{:.0}/{:?}/{}",
                        &p.models[m.model].name[..3],
                        m.loss,
                        m.f,
                        m.termination,
                        m.evaluations
                    )
                })
                .collect();
            println!("  {v} {}", row.join(" "));
        }
        for t in &st.tuned {
            println!(
                "   {} {:.6} {:.2} {:?} {}",
                t.vehicle, t.loss, t.f, t.termination, t.evaluations
            );
        }
    }
}
