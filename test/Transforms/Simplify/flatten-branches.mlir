// RUN: tai-opt %s --tai-flatten-branches --split-input-file | FileCheck %s
// RUN: tai-opt %s --tai-flatten-branches=max-ops=1 --split-input-file | FileCheck %s --check-prefix=SMALL
// RUN: tai-opt %s --tai-flatten-branches=force --split-input-file | FileCheck %s --check-prefix=FORCE

// Both arms are cheap and safe: they run, and the result is selected.
// CHECK-LABEL: func.func @safe(
//  CHECK-SAME:     %[[C:.+]]: i1, %[[A:.+]]: f32, %[[B:.+]]: f32)
//   CHECK-NOT:   scf.if
//       CHECK:   %[[M:.+]] = arith.mulf %[[A]], %[[B]]
//       CHECK:   %[[S:.+]] = math.sin %[[M]]
//       CHECK:   arith.select %[[C]], %[[S]], %[[B]]
// SMALL-LABEL: func.func @safe(
//       SMALL:   scf.if
func.func @safe(%c: i1, %a: f32, %b: f32) -> f32 attributes {passthrough = ["tai.lowered"]} {
  %r = scf.if %c -> (f32) {
    %m = arith.mulf %a, %b : f32
    %s = math.sin %m : f32
    scf.yield %s : f32
  } else {
    scf.yield %b : f32
  }
  return %r : f32
}

// -----

// The root of a negative number is NaN, and its derivative at zero infinite: it
// stays under its condition.
// CHECK-LABEL: func.func @root(
//       CHECK:   scf.if
//       CHECK:     math.sqrt
// FORCE-LABEL: func.func @root(
//   FORCE-NOT:   scf.if
//       FORCE:   arith.select
func.func @root(%a: f32) -> f32 attributes {passthrough = ["tai.lowered"]} {
  %zero = arith.constant 0.0 : f32
  %c = arith.cmpf ogt, %a, %zero : f32
  %r = scf.if %c -> (f32) {
    %s = math.sqrt %a : f32
    scf.yield %s : f32
  } else {
    scf.yield %zero : f32
  }
  return %r : f32
}

// -----

// A root of a positive number, and a division by a constant, are
// safe.
// CHECK-LABEL: func.func @safe_root(
//   CHECK-NOT:   scf.if
//       CHECK:   math.sqrt
//       CHECK:   arith.divf
//       CHECK:   arith.select
func.func @safe_root(%c: i1, %a: f32) -> f32 attributes {passthrough = ["tai.lowered"]} {
  %eps = arith.constant 1.0e-4 : f32
  %two = arith.constant 2.0 : f32
  %r = scf.if %c -> (f32) {
    %sq = arith.mulf %a, %a : f32
    %pos = arith.addf %sq, %eps : f32
    %s = math.sqrt %pos : f32
    %h = arith.divf %s, %two : f32
    scf.yield %h : f32
  } else {
    scf.yield %a : f32
  }
  return %r : f32
}

// -----

// CHECK-LABEL: func.func @division(
//       CHECK:   scf.if
func.func @division(%c: i1, %a: f32, %b: f32) -> f32 attributes {passthrough = ["tai.lowered"]} {
  %r = scf.if %c -> (f32) {
    %q = arith.divf %a, %b : f32
    scf.yield %q : f32
  } else {
    scf.yield %a : f32
  }
  return %r : f32
}

// -----

// An integer division by zero would trap, forced or not.
// CHECK-LABEL: func.func @trap(
//       CHECK:   scf.if
// FORCE-LABEL: func.func @trap(
//       FORCE:   scf.if
func.func @trap(%c: i1, %a: i32, %b: i32) -> i32 attributes {passthrough = ["tai.lowered"]} {
  %r = scf.if %c -> (i32) {
    %q = arith.divsi %a, %b : i32
    scf.yield %q : i32
  } else {
    scf.yield %a : i32
  }
  return %r : i32
}

// -----

tai.tree @t : !tai.root<dense<[i: 16], {x: f32}>>
tai.field @x = @t["x"] : f32, rank 1

// A store cannot run where the program would not have stored.
// CHECK-LABEL: tai.kernel @store(
//       CHECK:   scf.if
//       CHECK:     tai.store
// FORCE-LABEL: tai.kernel @store(
//       FORCE:   scf.if
tai.kernel @store(%c: i1, %a: f32) {
  %c0 = arith.constant 0 : index
  scf.if %c {
    tai.store %a, @x[%c0] : f32
  }
  tai.return
}

// A load whose index may lie outside of the field could fault.
// CHECK-LABEL: tai.kernel @unknown_index(
//       CHECK:   scf.if
// FORCE-LABEL: tai.kernel @unknown_index(
//       FORCE:   scf.if
tai.kernel @unknown_index(%c: i1, %a: f32, %i: index) -> f32 {
  %r = scf.if %c -> (f32) {
    %v = tai.load @x[%i] : f32
    scf.yield %v : f32
  } else {
    scf.yield %a : f32
  }
  tai.return %r : f32
}

// CHECK-LABEL: tai.kernel @known_index(
//   CHECK-NOT:   scf.if
//       CHECK:   tai.load
//       CHECK:   arith.select
tai.kernel @known_index(%c: i1, %a: f32) -> f32 {
  %c3 = arith.constant 3 : index
  %r = scf.if %c -> (f32) {
    %v = tai.load @x[%c3] : f32
    scf.yield %v : f32
  } else {
    scf.yield %a : f32
  }
  tai.return %r : f32
}

// -----

// The inner branch goes first, and then no longer holds back the outer one.
// CHECK-LABEL: func.func @nested(
//   CHECK-NOT:   scf.if
//       CHECK:   %[[INNER:.+]] = arith.select
//       CHECK:   %[[OUTER:.+]] = arith.select %{{.+}}, %[[INNER]]
//       CHECK:   return %[[OUTER]]
func.func @nested(%c: i1, %d: i1, %a: f32, %b: f32) -> f32 attributes {passthrough = ["tai.lowered"]} {
  %r = scf.if %c -> (f32) {
    %s = scf.if %d -> (f32) {
      scf.yield %a : f32
    } else {
      scf.yield %b : f32
    }
    scf.yield %s : f32
  } else {
    scf.yield %b : f32
  }
  return %r : f32
}

// -----

// A loop may not end where it would not have run.
// CHECK-LABEL: func.func @loop(
//       CHECK:   scf.if
// FORCE-LABEL: func.func @loop(
//       FORCE:   scf.if
func.func @loop(%c: i1, %n: index, %a: f32) -> f32 attributes {passthrough = ["tai.lowered"]} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %r = scf.if %c -> (f32) {
    %s = scf.for %i = %c0 to %n step %c1 iter_args(%v = %a) -> (f32) {
      %w = arith.addf %v, %a : f32
      scf.yield %w : f32
    }
    scf.yield %s : f32
  } else {
    scf.yield %a : f32
  }
  return %r : f32
}
