// Indices of host programs are always checked: there are few accesses, and no
// kernel looks at them.
// RUN: split-file %s %t
// RUN: not tai-run %t/far.mlir --no-cache 2>&1 | FileCheck %t/far.mlir
// RUN: not tai-run %t/near.mlir --no-cache 2>&1 | FileCheck %t/near.mlir
// RUN: not tai-run %t/near.mlir --no-cache --opt-level=0 2>&1 | FileCheck %t/near.mlir
// RUN: not tai-run %t/negative.mlir --no-cache 2>&1 | FileCheck %t/negative.mlir
// RUN: not tai-run %t/loop.mlir --no-cache 2>&1 | FileCheck %t/loop.mlir
// RUN: tai-run %t/good.mlir --no-cache

// As code for others: the check is in it.
// RUN: tai-opt %t/near.mlir --tai-to-llvm | FileCheck %s --check-prefix=AHEAD
// AHEAD-LABEL: llvm.func @main(
//       AHEAD:   llvm.call @tai_rt_fail(

//--- far.mlir
tai.tree @t : !tai.root<dense<[i: 6], {x: f64}>>
tai.field @x = @t["x"] : f64, rank 1
func.func @main() {
  %i = arith.constant 900000000 : index
  %v = arith.constant 1.0 : f64
  // CHECK: far.mlir:[[#@LINE+1]]:{{.*}}index {{\[900000000\]}} is out of range for field
  tai.store %v, @x[%i] : f64
  return
}
//--- near.mlir
tai.tree @t : !tai.root<dense<[i: 6], {x: f64, y: f64}>>
tai.field @x = @t["x"] : f64, rank 1
tai.field @y = @t["y"] : f64, rank 1
func.func @main() {
  %i = arith.constant 9 : index
  %j = arith.constant 1 : index
  // CHECK: near.mlir:[[#@LINE+1]]:{{.*}}index {{\[9\]}} is out of range for field
  %v = tai.load @x[%i] : f64
  tai.store %v, @y[%j] : f64
  return
}
//--- negative.mlir
tai.tree @t : !tai.root<dense<[i: 6], {x: vector<2xi32>}>>
tai.field @x = @t["x"] : vector<2xi32>, rank 1
func.func @main() {
  %i = arith.constant -1 : index
  %v = arith.constant dense<1> : vector<2xi32>
  // CHECK: negative.mlir:[[#@LINE+1]]:{{.*}}index {{\[-1\]}} is out of range for field
  tai.store %v, @x[%i] : vector<2xi32>
  return
}
//--- loop.mlir
tai.tree @t : !tai.root<pointer<[i: 4], dense<[i: 16], {x: f32}>>>
tai.field @x = @t["x"] : f32, rank 1
func.func @main() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %n = arith.constant 65 : index
  %v = arith.constant 1.0 : f32
  scf.for %i = %c0 to %n step %c1 {
    // CHECK: loop.mlir:[[#@LINE+1]]:{{.*}}index {{\[64\]}} is out of range for field
    %old = tai.atomic add %v, @x[%i] : f32
  }
  return
}
//--- good.mlir
tai.tree @t : !tai.root<pointer<[i: 4], dense<[i: 16], {x: f32}>>>
tai.field @x = @t["x"] : f32, rank 1, offset [-8]
func.func @main() {
  %c0 = arith.constant -8 : index
  %c1 = arith.constant 1 : index
  %n = arith.constant 56 : index
  %one = arith.constant 1.0 : f32
  scf.for %i = %c0 to %n step %c1 {
    tai.store %one, @x[%i] : f32
    %v = tai.load @x[%i] : f32
    tai_check.close %v, %one tolerance 0.0 : f32
  }
  return
}
