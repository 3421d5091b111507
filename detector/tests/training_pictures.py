"""What `train/` does to pictures before the net sees them, on a made camera. Run by training_pictures.rs."""

import dataclasses
import os
import sys
import tempfile
import unittest

import cv2
import numpy as np

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "train"))
import augment
import data
import paste
import road

WIDTH, HEIGHT = 320, 240
CAR = 30, 22  # px


def camera(folder, count=12):
    """Pictures of one camera: a road with a painted block at the same place in all, and one car
    each, lower from picture to picture."""
    rng = np.random.default_rng(1)
    base = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
    cv2.putText(base, "SLOW", (200, 120), cv2.FONT_HERSHEY_SIMPLEX, 0.9, (235, 235, 235), 3)
    pictures = []
    for n in range(count):
        img = np.clip(base + rng.normal(0, 2, base.shape), 0, 255).astype(np.uint8)
        x, y = 60 + 5 * (n % 3), 20 + 17 * n
        img[y:y + CAR[1], x:x + CAR[0]] = (40, 40, 160)
        img[y + 4:y + 9, x + 4:x + 26] = (200, 190, 180)
        path = os.path.join(folder, f"c-{n:02}.png")
        cv2.imwrite(path, img)
        box = np.array([[x, y, x + CAR[0], y + CAR[1]]], np.float32)
        pictures.append(data.Picture(path, "sg_lta", "c", "train", WIDTH, HEIGHT, box, np.array([1]),
                                     False, HEIGHT, True))
    return pictures


class Pictures(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()
        self.pictures = camera(self.folder.name)

    def tearDown(self):
        self.folder.cleanup()

    def test_a_teachers_box_on_the_road_goes_and_one_on_a_car_stays(self):
        paint = [198, 94, 300, 124, 0.9]
        found = {p.path: np.array([[*p.boxes[0], 0.8], paint], np.float32) for p in self.pictures}
        gone = road.settle(self.pictures, found)
        self.assertEqual(gone, len(self.pictures))
        for p in self.pictures:
            self.assertEqual(len(found[p.path]), 1, p.name)
            self.assertAlmostEqual(float(found[p.path][0, 4]), 0.8, 5)

    def test_too_few_pictures_settle_nothing(self):
        few = self.pictures[:road.FEWEST - 1]
        found = {p.path: np.array([[198, 94, 300, 124, 0.9]], np.float32) for p in few}
        self.assertEqual(road.settle(few, found), 0)

    def test_vehicles_are_pasted_where_they_stood(self):
        stock = paste.Stock(self.pictures)
        self.assertEqual(len(stock), len(self.pictures))
        p = self.pictures[0]
        truth, kinds, ignored = p.targets()
        before = p.read()
        img, more, classes, hidden = stock.crowd(p, before, truth, kinds, ignored, np.random.default_rng(3))
        self.assertGreater(len(more), 1)
        self.assertEqual(len(more), len(classes))
        known = {tuple(q.boxes[0]) for q in self.pictures}
        for box in [*more, *hidden]:
            self.assertIn(tuple(box), known)
            x0, y0, x1, y1 = box.astype(int)
            if tuple(box) != tuple(p.boxes[0]):
                change = np.abs(img.astype(int) - before)[y0:y1, x0:x1].max(2)
                self.assertGreater((change > 20).mean(), 0.25, box)
        self.assertTrue((before == p.read()).all(), "the stored picture is left alone")

    def test_no_vehicle_stays_that_others_hide(self):
        stock = paste.Stock(self.pictures)
        name = road.name(self.pictures[0])
        box, kind, pixels, alpha = stock.vehicles[name][5]
        x0, y0, x1, y1 = box
        behind = np.array([[x0 + 4, y0 + 2, x1 - 4, y1 - 6]], np.float32)
        stock.vehicles[name] = [(box, kind, pixels, alpha)]
        rng = np.random.default_rng(0)
        bounds = paste.INSIDE
        paste.INSIDE = 1.1
        try:
            _, truth, _, ignored = stock.crowd(self.pictures[0], self.pictures[0].read(), behind,
                                               np.array([1]), np.zeros((0, 4), np.float32), rng)
        finally:
            paste.INSIDE = bounds
        self.assertEqual([tuple(b) for b in truth], [tuple(box)])
        self.assertEqual([tuple(b) for b in ignored], [tuple(behind[0])])

    def test_paint_stays_off_vehicles_and_marks_change_pixels_alone(self):
        truth = self.pictures[3].boxes
        x0, y0, x1, y1 = truth[0].astype(int)
        changed = 0
        for seed in range(80):
            img = self.pictures[3].read()
            paste.painted(img, truth, np.random.default_rng(seed))
            before = self.pictures[3].read()
            changed += (img != before).any()
            self.assertTrue((img[y0 + 1:y1 - 1, x0 + 1:x1 - 1] == before[y0 + 1:y1 - 1, x0 + 1:x1 - 1]).all(), seed)
        self.assertGreater(changed, 20)
        boxes = truth.copy()
        _, covered = paste.marks(self.pictures[3].read(), truth, np.random.default_rng(0))
        self.assertTrue((truth == boxes).all())
        self.assertEqual(covered.tolist(), [False])

    def test_a_vehicle_that_words_cover_is_not_taught(self):
        def block(img, truth, rng):
            img[:] = 255

        words, paste.burnt_words = paste.burnt_words, block
        try:
            covered = [paste.marks(self.pictures[3].read(), self.pictures[3].boxes,
                                   np.random.default_rng(seed))[1][0] for seed in range(20)]
        finally:
            paste.burnt_words = words
        self.assertIn(True, covered)
        self.assertIn(False, covered)

    def test_nothing_is_pasted_where_the_camera_looked_elsewhere(self):
        moved = self.pictures[4]
        img = moved.read()
        cv2.imwrite(moved.path, np.roll(img, 90, 1)[::-1])
        stock = paste.Stock(self.pictures)
        self.assertEqual(len(stock), len(self.pictures) - 1)
        same, truth, _, _ = stock.crowd(moved, moved.read(), *moved.targets(), np.random.default_rng(3))
        self.assertTrue((same == moved.read()).all())
        self.assertEqual(len(truth), 1)
        for p in self.pictures[5:9]:
            cv2.imwrite(p.path, np.roll(p.read(), 90, 1)[::-1])
        self.assertEqual(len(paste.Stock(self.pictures)), 0)

    def test_a_window_depends_on_its_seed_alone(self):
        recipe = augment.Recipe((0.6, 2.5), 1.0, 1.0, paste.Stock(self.pictures))
        make = lambda: augment.sample(self.pictures, 2, np.random.default_rng([7, 1]), 416, 320, recipe)
        first, second = make(), make()
        for a, b in zip(first, second):
            self.assertTrue(np.array_equal(a, b))
        plain = dataclasses.replace(recipe, crowd=0.0, marks=0.0)
        other = augment.sample(self.pictures, 2, np.random.default_rng([7, 1]), 416, 320, plain)
        self.assertFalse(np.array_equal(first[0], other[0]))


if __name__ == "__main__":
    unittest.main()
