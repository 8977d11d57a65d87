// RUN: tai-run %s --interpret --no-cache --print-field=@y,@last | FileCheck %s
// RUN: tai-run %s --interpret --interpret-order=5 --no-cache --print-field=@y | FileCheck %s --check-prefix=ORDER
// RUN: tai-run %s --interpret --interpret-order=5 --no-cache --print-field=@last | FileCheck %s --check-prefix=SHUFFLED
// RUN: tai-run %s --no-cache --print-field=@y | FileCheck %s --check-prefix=ORDER

// Loops, branches, calls, variables and arguments. With an order drawn from a
// seed, iterations that do not depend on one another have the same results, and
// others do not.

tai.tree @s : !tai.root<dense<[i: 6], {y: i32}>, {last: i32}>
tai.field @y = @s["y"] : i32, rank 1
tai.field @last = @s["last"] : i32, rank 0

func.func private @double(%x: i32) -> i32 {
  %two = arith.constant 2 : i32
  %r = arith.muli %x, %two : i32
  return %r : i32
}

// For i: the sum of 0 to i - 1, plus twice the arguments' sum, plus the number
// of halvings until i is 0, plus 100 for odd i.
// CHECK:      129
// CHECK-NEXT: @y : 6xi32 = [16, 117, 19, 121, 25, 129]
// CHECK-NEXT: @last : i32 = 5
// ORDER:      129
// ORDER-NEXT: @y : 6xi32 = [16, 117, 19, 121, 25, 129]
// SHUFFLED:      129
// SHUFFLED-NEXT: @last : i32 = {{[0-4]$}}
tai.kernel @work(%a: i32, %v: vector<2xi32>) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c6 = arith.constant 6 : index
  %zero = arith.constant 0 : i32
  %one = arith.constant 1 : i32
  %two = arith.constant 2 : i32
  %hundred = arith.constant 100 : i32
  tai.parallel_for (%i) = (%c0) to (%c6) {
    %n = arith.index_cast %i : index to i32
    tai.store %n, @last[] : i32
    %sum = scf.for %j = %c0 to %i step %c1 iter_args(%s = %zero) -> (i32) {
      %k = arith.index_cast %j : index to i32
      %t = arith.addi %s, %k : i32
      scf.yield %t : i32
    }
    %all = tai.sum %v : vector<2xi32>
    %with = arith.addi %all, %a : i32
    %twice = func.call @double(%with) : (i32) -> i32
    %halvings:2 = scf.while (%x = %n, %c = %zero) : (i32, i32) -> (i32, i32) {
      %more = arith.cmpi sgt, %x, %zero : i32
      scf.condition(%more) %x, %c : i32, i32
    } do {
    ^bb0(%x: i32, %c: i32):
      %half = arith.divsi %x, %two : i32
      %next = arith.addi %c, %one : i32
      scf.yield %half, %next : i32, i32
    }
    %local = tai.alloca : !tai.local<i32>
    %odd = arith.andi %n, %one : i32
    %isOdd = arith.cmpi eq, %odd, %one : i32
    scf.if %isOdd {
      tai.local_store %hundred, %local : i32
    }
    %extra = tai.local_load %local : i32
    %p = arith.addi %sum, %twice : i32
    %q = arith.addi %p, %halvings#1 : i32
    %r = arith.addi %q, %extra : i32
    tai.store %r, @y[%i] : i32
  }
  tai.return
}

tai.kernel @pick(%i: index) -> i32 {
  %x = tai.load @y[%i] : i32
  tai.return %x : i32
}

tai.kernel @show(%x: i32) {
  tai.print "{}"(%x) : i32
  tai.return
}

func.func @main() {
  %one = arith.constant 1 : i32
  %v = arith.constant dense<[3, 4]> : vector<2xi32>
  tai.launch @work(%one, %v) : (i32, vector<2xi32>) -> ()
  %c5 = arith.constant 5 : index
  %x = tai.launch @pick(%c5) : (index) -> i32
  tai.launch @show(%x) : (i32) -> ()
  return
}
