// Indices of host programs are always checked: there are few accesses, and no
// kernel looks at them.
// RUN: split-file %s %t
// RUN: not tai-run %t/far.mlir --no-cache 2>&1 | FileCheck %t/far.mlir
// RUN: not tai-run %t/near.mlir --no-cache 2>&1 | FileCheck %t/near.mlir
// RUN: not tai-run %t/near.mlir --no-cache --opt-level=0 2>&1 | FileCheck %t/near.mlir
// RUN: not tai-run %t/negative.mlir --no-cache 2>&1 | FileCheck %t/negative.mlir
// RUN: not tai-run %t/loop.mlir --no-cache 2>&1 | FileCheck %t/loop.mlir
// RUN: not tai-run %t/read.mlir --no-cache 2>&1 | FileCheck %t/read.mlir
// RUN: not tai-run %t/gradient.mlir --no-cache 2>&1 | FileCheck %t/gradient.mlir
// RUN: not tai-run %t/activate.mlir --no-cache 2>&1 | FileCheck %t/activate.mlir
// RUN: not tai-run %t/second.mlir --no-cache 2>&1 | FileCheck %t/second.mlir
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
//--- read.mlir
tai.tree @t : !tai.root<dense<[i: 6], {x: f64}>, {n: i32}>
tai.field @x = @t["x"] : f64, rank 1
tai.field @n = @t["n"] : i32, rank 0
func.func @main() {
  %v = arith.constant 1.0 : f64
  %six = arith.constant 6 : i32
  tai.store %six, @n[] : i32
  %n = tai.load @n[] : i32
  %i = arith.index_cast %n : i32 to index
  // CHECK: read.mlir:[[#@LINE+1]]:{{.*}}index {{\[6\]}} is out of range for field
  %old = tai.atomic max %v, @x[%i] : f64
  return
}
//--- gradient.mlir
tai.tree @t : !tai.root<dense<[i: 6], {x: f64, xg: f64}>, {l: f64, lg: f64}>
tai.field @x = @t["x"] : f64, rank 1, adjoint @xg
tai.field @xg = @t["xg"] : f64, rank 1
tai.field @l = @t["l"] : f64, rank 0, adjoint @lg
tai.field @lg = @t["lg"] : f64, rank 0
tai.kernel @k() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    %1 = tai.atomic add %0, @l[] : f64
  }
  tai.return
}
func.func @main() {
  %v = arith.constant 1.0 : f64
  %i = arith.constant 6 : index
  tai_check.gradient loss(@l) wrt [@x] tolerance 1.0e-7 {
    // CHECK: gradient.mlir:[[#@LINE+1]]:{{.*}}index {{\[6\]}} is out of range for field
    tai.store %v, @x[%i] : f64
    tai.launch @k() : () -> ()
  }
  return
}
//--- activate.mlir
tai.tree @t : !tai.root<pointer<[i: 4], dense<[i: 4], {x: f64}>>>
tai.field @x = @t["x"] : f64, rank 1
func.func @main() {
  %i = arith.constant 16 : index
  // CHECK: activate.mlir:[[#@LINE+1]]:{{.*}}index {{\[16\]}} is out of range for field
  tai.activate @x[%i] level 1
  return
}
//--- second.mlir
tai.tree @t : !tai.root<dense<[i: 3, j: 5], {x: f32}>>
tai.field @x = @t["x"] : f32, rank 2
func.func @main() {
  %v = arith.constant 1.0 : f32
  %i = arith.constant 1 : index
  %j = arith.constant -1 : index
  // CHECK: second.mlir:[[#@LINE+1]]:{{.*}}index {{\[1, -1\]}} is out of range for field
  tai.store %v, @x[%i, %j] : f32
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
