// REQUIRES: libdevice
// RUN: tai-opt %s --tai-to-nvvm | tai-translate --tai-to-ptx --device-floats=strict | FileCheck %s --implicit-check-not=.extern --implicit-check-not=call
// RUN: tai-opt %s --tai-to-nvvm | tai-translate --tai-to-ptx --device-floats=default | FileCheck %s --implicit-check-not=.extern --implicit-check-not=call
// RUN: tai-opt %s --tai-to-nvvm=fast-math=true | tai-translate --tai-to-ptx --device-floats=fast | FileCheck %s --implicit-check-not=.extern --implicit-check-not=call
// RUN: tai-opt %s --tai-autodiff --tai-to-nvvm | tai-translate --tai-to-ptx --device-floats=default | FileCheck %s --check-prefixes=CHECK,ADJOINT --implicit-check-not=.extern --implicit-check-not=call
// RUN: tai-opt %s --tai-autodiff --tai-to-nvvm=fast-math=true | tai-translate --tai-to-ptx --device-floats=fast | FileCheck %s --check-prefixes=CHECK,ADJOINT --implicit-check-not=.extern --implicit-check-not=call

// Integer powers and arithmetic in 128 bits have no instruction, and a device
// has no library of the compiler to call: __powisf2, __powidf2, __multi3,
// __divti3 and the like must not remain.

!t = !tai.root<dense<[i: 64], {x: f32, dx: f32, y: f32, dy: f32, a: f64, da: f64, b: f64, db: f64, n: i32, m: i64}>>
tai.tree @t : !t
tai.field @dx = @t["dx"] : f32, rank 1
tai.field @dy = @t["dy"] : f32, rank 1
tai.field @da = @t["da"] : f64, rank 1
tai.field @db = @t["db"] : f64, rank 1
tai.field @x = @t["x"] : f32, rank 1, adjoint @dx
tai.field @y = @t["y"] : f32, rank 1, adjoint @dy
tai.field @a = @t["a"] : f64, rank 1, adjoint @da
tai.field @b = @t["b"] : f64, rank 1, adjoint @db
tai.field @n = @t["n"] : i32, rank 1
tai.field @m = @t["m"] : i64, rank 1

// CHECK: .entry powers_0(
tai.kernel @powers(%k: i32) {
  tai.parallel_for (%i) in @x {
    %c3 = arith.constant 3 : i32
    %cm2 = arith.constant -2 : i32
    %n = tai.load @n[%i] : i32
    %x = tai.load @x[%i] : f32
    %0 = math.fpowi %x, %n : f32, i32
    %1 = math.fpowi %0, %k : f32, i32
    %2 = math.fpowi %1, %c3 : f32, i32
    %3 = math.fpowi %2, %cm2 : f32, i32
    tai.store %3, @y[%i] : f32
    %a = tai.load @a[%i] : f64
    %4 = math.fpowi %a, %n : f64, i32
    %5 = math.fpowi %4, %k : f64, i32
    tai.store %5, @b[%i] : f64
  }
  tai.return
}

// ADJOINT: .entry powers_grad_0(
// CHECK: .entry wide_0(
tai.kernel @wide(%k: i64) {
  tai.parallel_for (%i) in @m {
    %m = tai.load @m[%i] : i64
    %low, %high = arith.mulsi_extended %m, %k : i64
    %ulow, %uhigh = arith.mului_extended %m, %k : i64
    %0 = arith.addi %high, %uhigh : i64
    %c64 = arith.constant 64 : i128
    %c1 = arith.constant 1 : i64
    %1 = arith.extsi %m : i64 to i128
    %odd = arith.ori %0, %c1 : i64
    %2 = arith.extsi %odd : i64 to i128
    %3 = arith.muli %1, %2 : i128
    %4 = arith.divsi %3, %2 : i128
    %5 = arith.remui %3, %2 : i128
    %6 = arith.shrsi %3, %c64 : i128
    %7 = arith.addi %4, %5 : i128
    %8 = arith.addi %7, %6 : i128
    %9 = arith.trunci %8 : i128 to i64
    tai.store %9, @m[%i] : i64
  }
  tai.return
}
