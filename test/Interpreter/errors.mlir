// RUN: split-file %s %t
// RUN: not tai-run %t/field.mlir --interpret --no-cache 2>&1 | FileCheck %t/field.mlir
// RUN: not tai-run %t/component.mlir --interpret --no-cache 2>&1 | FileCheck %t/component.mlir
// RUN: not tai-run %t/shift.mlir --interpret --no-cache 2>&1 | FileCheck %t/shift.mlir
// RUN: not tai-run %t/cast.mlir --interpret --no-cache 2>&1 | FileCheck %t/cast.mlir
// RUN: not tai-run %t/flags.mlir --interpret --no-cache 2>&1 | FileCheck %t/flags.mlir
// RUN: not tai-run %t/unknown.mlir --interpret --no-cache 2>&1 | FileCheck %t/unknown.mlir
// RUN: not tai-run %t/assert.mlir --interpret --debug --no-cache 2>&1 | FileCheck %t/assert.mlir
// RUN: tai-run %t/assert.mlir --interpret --no-cache
// RUN: not tai-run %t/precondition.mlir --interpret --no-cache 2>&1 | FileCheck %t/precondition.mlir

// An undefined result ends the program, at its place.

//--- field.mlir
tai.tree @s : !tai.root<dense<[i: 4, j: 2], {x: f32}>>
tai.field @x = @s["x"] : f32, rank 2, offset [-1, 0]
// The last element is [2, 1].
tai.kernel @k(%i: index) {
  %zero = arith.constant 0.0 : f32
  %c1 = arith.constant 1 : index
  // CHECK: field.mlir:[[#@LINE + 1]]:3: error: index [3, 1] is out of range for field '@x' of shape [4, 2], which begins at [-1, 0]
  tai.store %zero, @x[%i, %c1] : f32
  tai.return
}
func.func @main() {
  %c3 = arith.constant 3 : index
  tai.launch @k(%c3) : (index) -> ()
  return
}

//--- component.mlir
tai.tree @s : !tai.root<dense<[i: 4], {v: vector<3xf32>}>>
tai.field @v = @s["v"] : vector<3xf32>, rank 1
tai.kernel @k(%c: index) {
  // CHECK: component.mlir:[[#@LINE + 1]]:8: error: index [3] is out of range for an element of shape [3] of field '@v'
  %x = tai.load @v[%c] component [%c] : f32
  tai.return
}
func.func @main() {
  %c3 = arith.constant 3 : index
  tai.launch @k(%c3) : (index) -> ()
  return
}

//--- shift.mlir
tai.kernel @k(%n: i16) {
  // CHECK: shift.mlir:[[#@LINE + 1]]:8: error: a number of 16 bits is shifted by 16
  %x = arith.shli %n, %n : i16
  tai.return
}
func.func @main() {
  %n = arith.constant 16 : i16
  tai.launch @k(%n) : (i16) -> ()
  return
}

//--- cast.mlir
tai.kernel @k(%f: f32) {
  // CHECK: cast.mlir:[[#@LINE + 1]]:8: error: no integer of 8 bits stands for 300
  %x = arith.fptosi %f : f32 to i8
  tai.return
}
func.func @main() {
  %f = arith.constant 300.0 : f32
  tai.launch @k(%f) : (f32) -> ()
  return
}

//--- flags.mlir
tai.kernel @k(%n: i8) {
  // CHECK: flags.mlir:[[#@LINE + 1]]:8: error: the result overflows, which the operation promises it does not
  %x = arith.addi %n, %n overflow<nsw> : i8
  tai.return
}
func.func @main() {
  %n = arith.constant 100 : i8
  tai.launch @k(%n) : (i8) -> ()
  return
}

//--- unknown.mlir
tai.kernel @k(%v: vector<4xf32>) {
  // CHECK: unknown.mlir:[[#@LINE + 1]]:8: error: the interpreter does not know 'vector.transpose'
  %t = vector.transpose %v, [0] : vector<4xf32> to vector<4xf32>
  tai.return
}
func.func @main() {
  %v = arith.constant dense<0.0> : vector<4xf32>
  tai.launch @k(%v) : (vector<4xf32>) -> ()
  return
}

//--- assert.mlir
tai.kernel @k(%n: i32) {
  %zero = arith.constant 0 : i32
  %holds = arith.cmpi eq, %n, %zero : i32
  // CHECK: assert.mlir:[[#@LINE + 1]]:3: error: n is 4
  tai.assert %holds, "n is {}"(%n) : i32
  tai.return
}
func.func @main() {
  %n = arith.constant 4 : i32
  tai.launch @k(%n) : (i32) -> ()
  return
}

//--- precondition.mlir
// Nothing runs, wherever the precondition stands.
// CHECK-NOT: not reached
// CHECK: precondition.mlir:[[#@LINE + 6]]:3: error: step 9 of 8
tai.kernel @k(%t: index) {
  tai.print "not reached"
  %c8 = arith.constant 8 : index
  %ok = arith.cmpi ult, %t, %c8 : index
  // The condition follows from the argument.
  tai.precondition %ok, "step {} of {}"(%t, %c8) : index, index
  tai.return
}
func.func @main() {
  %t = arith.constant 9 : index
  tai.launch @k(%t) : (index) -> ()
  return
}
