// RUN: tai-run %s --no-cache | FileCheck %s
// RUN: tai-run %s --no-cache --opt-level=0 | FileCheck %s
// RUN: not tai-run %s --no-cache --debug 2>&1 | FileCheck %s --check-prefix=DEBUG

// Forms of division that Python does not write, in a kernel and on the host.
tai.tree @t : !tai.root<dense<[i: 4], {d: i32}>>
tai.field @d = @t["d"] : i32, rank 1

// CHECK: 7: 0 0 0 0 0
// CHECK: 7: 7 7 7 7 0
// CHECK: 7: 4 3 4 3 1
// CHECK: 7: -7 -7 1 0 0
// DEBUG: integer-division.mlir:[[# @LINE + 10]]:{{[0-9]+}}: error: a whole number is divided by zero
// DEBUG: %1 = arith.floordivsi
tai.kernel @divide(%a: i32) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  // In their order.
  tai.parallel_for (%p) = (%c0) to (%c1) {
    scf.for %i = %c0 to %c4 step %c1 {
      %b = tai.load @d[%i] : i32
      %1 = arith.floordivsi %a, %b : i32
      %0 = arith.ceildivsi %a, %b : i32
      %2 = arith.ceildivui %a, %b : i32
      %3 = arith.divui %a, %b : i32
      %4 = arith.remsi %a, %b : i32
      tai.print "{}: {} {} {} {} {}"(%a, %0, %1, %2, %3, %4) : i32, i32, i32, i32, i32, i32
    }
  }
  tai.return
}

tai.kernel @set(%at: index, %b: i32) {
  tai.store %b, @d[%at] : i32
  tai.return
}

func.func @main() {
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %one = arith.constant 1 : i32
  %two = arith.constant 2 : i32
  %minus = arith.constant -1 : i32
  %seven = arith.constant 7 : i32
  tai.launch @set(%c1, %one) : (index, i32) -> ()
  tai.launch @set(%c2, %two) : (index, i32) -> ()
  tai.launch @set(%c3, %minus) : (index, i32) -> ()
  tai.launch @divide(%seven) : (i32) -> ()
  return
}
