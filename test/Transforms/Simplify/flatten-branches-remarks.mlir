// RUN: tai-opt %s --tai-flatten-branches=max-ops=2 --remark-format=emitRemark --remarks-filter=tai-branches -o /dev/null 2>&1 | FileCheck %s

!t = !tai.root<dense<[i: 16], {x: f32}>>
tai.tree @t : !t
tai.field @x = @t["x"] : f32, rank 1

// The treatment of a branch is reported, with the reason if it stays.
// CHECK: [[# @LINE + 6]]:8: remark: [Passed] flattened | Category:tai-branches | Function=all | Remark="both arms run, and a select takes the result"
// CHECK: remark: [Missed] kept | {{.*}} Reason="a value or derivative can be infinite or NaN where its arm does not run", Remark="the branch stays"
// CHECK: remark: [Missed] kept | {{.*}} Reason="an arm has an effect or can fault"
// CHECK: remark: [Missed] kept | {{.*}} Reason="an arm holds a loop or a branch that stays"
// CHECK: remark: [Missed] kept | {{.*}} Reason="the arms are long"
tai.kernel @all(%c: i1, %a: f32) {
  %r = scf.if %c -> (f32) {
    %s = math.sin %a : f32
    scf.yield %s : f32
  } else {
    scf.yield %a : f32
  }
  %q = scf.if %c -> (f32) {
    %s = math.sqrt %a : f32
    scf.yield %s : f32
  } else {
    scf.yield %r : f32
  }
  tai.parallel_for (%i) in @x {
    scf.if %c {
      scf.if %c {
        tai.store %q, @x[%i] : f32
      }
    }
    %l = scf.if %c -> (f32) {
      %0 = math.sin %a : f32
      %1 = math.sin %0 : f32
      %2 = math.sin %1 : f32
      scf.yield %2 : f32
    } else {
      scf.yield %r : f32
    }
    tai.store %l, @x[%i] : f32
  }
  tai.return
}
