// RUN: tai-run %s --no-cache --skips | FileCheck %s --check-prefixes=CHECK,ALL
// RUN: tai-run %s --no-cache --skips --tai-skip=none | FileCheck %s --check-prefixes=CHECK,NONE
// RUN: tai-run %s --no-cache --skips --tai-skip=all,-unchanged-lists | FileCheck %s --check-prefixes=CHECK,SOME
// RUN: not tai-run %s --tai-skip=lists 2>&1 | FileCheck %s --check-prefix=WRONG

// WRONG: option 'skip': there is no skip 'lists'; the skips are all, none, unchanged-lists,

tai.tree @t : !tai.root<pointer<[i: 4], dense<[i: 8], {x: i32}>>>
tai.field @x = @t["x"] : i32, rank 1

tai.kernel @put(%i: index) {
  %c = arith.constant 1 : i32
  tai.store %c, @x[%i] : i32
  tai.return
}

tai.kernel @step() {
  %c = arith.constant 1 : i32
  tai.parallel_for (%i) in @x {
    %0 = tai.atomic add %c, @x[%i] : i32
  }
  tai.return
}

tai.kernel @show(%i: index) {
  %0 = tai.load @x[%i] : i32
  tai.print "x = {}"(%0) : i32
  tai.return
}

// CHECK: x = 4
//  ALL: unchanged-lists            on   made 1, reused 2
// NONE: unchanged-lists            off  made 4, reused 0
// SOME: unchanged-lists            off  made 3, reused 0
//  ALL: activity-tests   on   writes demoted 1, writes kept 1
// NONE: activity-tests   off  writes demoted 0, writes kept 2
// SOME: activity-tests   on   writes demoted 1, writes kept 1
//  ALL: repeated-lookups     on   cells 8, located 1
// NONE: repeated-lookups     off  cells 8, located 8
//  ALL: empty-loops           on   launches skipped 1, empty loops run 0
// NONE: empty-loops           off  launches skipped 0, empty loops run 1
// CHECK: unlaunched-kernels
func.func @main() {
  %c3 = arith.constant 3 : index
  tai.launch @step() : () -> ()
  tai.launch @put(%c3) : (index) -> ()
  tai.launch @step() : () -> ()
  tai.launch @step() : () -> ()
  tai.launch @step() : () -> ()
  tai.launch @show(%c3) : (index) -> ()
  return
}
