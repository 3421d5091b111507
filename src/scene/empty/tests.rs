//! Tests of the empty road: what it learns, what it must not, and what looks like it.

use super::super::reference::Point;
use super::*;
use std::vec::Vec;

const SIDE: usize = 96;

fn grid() -> Grid {
    Grid::of(SIDE, SIDE)
}

fn road() -> EmptyRoad<Vec<MeanCell>> {
    let len = EmptyRoad::<Vec<MeanCell>>::buffer_len(grid());
    EmptyRoad::new(grid(), std::vec![[0; 2]; len]).expect("the length that it asks for")
}

/// A field with one direction in each of some squares of 16 cells, else none.
fn field(squares: &[(usize, usize, Cell)]) -> Vec<Cell> {
    let mut cells = std::vec![[0; 2]; SIDE * SIDE];
    for &(x0, y0, edge) in squares {
        for y in y0..y0 + 16 {
            cells[y * SIDE + x0..][..16].fill(edge);
        }
    }
    cells
}

fn of(cells: &[Cell]) -> Field<'_> {
    Field { cells, width: SIDE, height: SIDE }
}

fn square(x0: f32, y0: f32) -> PixelBox {
    PixelBox { x0, y0, x1: x0 + 16.0, y1: y0 + 16.0 }
}

const ARROW: (usize, usize, Cell) = (16, 16, [90, 20]);
const CAR: (usize, usize, Cell) = (64, 64, [-20, 90]);
const STILL: (f32, f32) = (0.0, 0.0);

fn at(i: u32) -> Duration {
    LEARN_SPACING * i
}

#[test]
fn a_painted_arrow_is_the_road_and_a_car_on_it_is_none() {
    let (mut road, empty) = (road(), field(&[ARROW]));
    for i in 0..60 {
        assert!(road.learn(&of(&empty), STILL, Light::Day, at(i), &[]));
    }
    let arrow = square(16.0, 16.0);
    let like = |cells: &[Cell], light, bounds| road.likeness(&of(cells), STILL, light, bounds);
    assert!(like(&empty, Light::Day, &arrow) > 0.75);
    assert_eq!(like(&empty, Light::Night, &arrow), 0.0, "nothing is known of the night");
    let car_on_it = field(&[(16, 16, [-20, 90])]);
    assert!(like(&car_on_it, Light::Day, &arrow) < 0.1);
    let car = field(&[ARROW, CAR]);
    assert!(like(&car, Light::Day, &square(64.0, 64.0)) < 0.1, "the road is bare there");
}

#[test]
fn a_standing_queue_is_not_learned() {
    let (mut road, queue) = (road(), field(&[ARROW, CAR]));
    let car = square(64.0, 64.0);
    // A day at one picture each ten seconds, the car found in each, if only as a doubtful box.
    for i in 0..8640 {
        road.learn(&of(&queue), STILL, Light::Day, at(i), &[car]);
    }
    assert!(road.likeness(&of(&queue), STILL, Light::Day, &car) < 0.05);
    assert!(road.likeness(&of(&queue), STILL, Light::Day, &square(16.0, 16.0)) > 0.8);
    // One that is missed for ten minutes is not either.
    let mut road = self::road();
    let empty = field(&[ARROW]);
    for i in 0..400 {
        road.learn(&of(&empty), STILL, Light::Day, at(i), &[]);
    }
    for i in 400..460 {
        road.learn(&of(&queue), STILL, Light::Day, at(i), &[]);
    }
    let noticed = road.likeness(&of(&queue), STILL, Light::Day, &car);
    assert!(noticed < 0.95, "{noticed}");
    for i in 460..2000 {
        road.learn(&of(&empty), STILL, Light::Day, at(i), &[]);
    }
    assert!(road.likeness(&of(&queue), STILL, Light::Day, &car) < 0.4, "and is forgotten");
}

#[test]
fn it_learns_in_reference_coordinates() {
    let mut road = road();
    let shifted = field(&[(18, 15, [90, 20])]);
    for i in 0..60 {
        road.learn(&of(&shifted), (2.0, -1.0), Light::Day, at(i), &[]);
    }
    let empty = field(&[ARROW]);
    assert!(road.likeness(&of(&empty), STILL, Light::Day, &square(16.0, 16.0)) > 0.75);
    let seen = road.likeness(&of(&shifted), (2.0, -1.0), Light::Day, &square(18.0, 15.0));
    assert!(seen > 0.75);
}

#[test]
fn pictures_in_a_burst_count_once_and_the_age_is_known() {
    let (mut road, empty) = (road(), field(&[ARROW]));
    assert_eq!(road.age(Light::Day, at(5)), None);
    assert!(road.learn(&of(&empty), STILL, Light::Day, at(5), &[]));
    assert!(!road.learn(&of(&empty), STILL, Light::Day, at(5) + LEARN_SPACING / 2, &[]));
    assert_eq!(road.seen(Light::Day), 1);
    assert_eq!(road.age(Light::Day, at(8)), Some(at(3)));
    assert_eq!(road.age(Light::Night, at(8)), None);
}

#[test]
fn it_begins_with_the_lane_tables_edges() {
    let mut road = road();
    let edges = field(&[ARROW]);
    let point = |i: usize| Point { x: 16 + i as u16 % 16, y: 16 + i as u16 / 16, edge: ARROW.2 };
    let fine = (0..256).map(point).collect();
    let reference = Reference { width: SIDE, height: SIDE, fine, ..Reference::default() };
    road.begin_with(&reference);
    assert_eq!((road.seen(Light::Day), road.seen(Light::Night)), (4, 4));
    let like = road.likeness(&of(&edges), STILL, Light::Night, &square(16.0, 16.0));
    assert!(like > 0.05, "{like}");
}

#[test]
fn what_was_learned_is_taken_up_again_with_its_age() {
    let (mut road, mut later, empty) = (road(), self::road(), field(&[ARROW]));
    for i in 0..60 {
        road.learn(&of(&empty), STILL, Light::Day, at(i), &[]);
    }
    let known = road.known(at(60));
    assert!(!later.resume(known, &road.cells()[1..], Duration::ZERO), "of another size");
    assert_eq!(later.seen(Light::Day), 0, "nothing of it was taken");
    assert!(later.resume(known, road.cells(), Duration::ZERO));
    let like = |road: &EmptyRoad<Vec<MeanCell>>| {
        road.likeness(&of(&empty), STILL, Light::Day, &square(16.0, 16.0))
    };
    assert_eq!(like(&later), like(&road));
    assert_eq!(later.age(Light::Day, at(2)), Some(LEARN_SPACING * 3));
    assert_eq!(later.age(Light::Night, at(2)), None);
    assert!(later.learn(&of(&empty), STILL, Light::Day, at(3), &[]), "it goes on learning");
    assert_eq!(later.age(Light::Day, at(3)), Some(Duration::ZERO));
}
